#!/usr/bin/env bash
# Run a command where SocketCAN and a virtual bus vcan0 (CAN FD) exist.
#
#   scripts/ci/with-vcan.sh COMMAND [ARGUMENT...]
#
# Where this kernel has SocketCAN (and vcan0 is there, or may be made), the command simply runs.
# Elsewhere it runs in User-Mode Linux (Debian: apt-get install user-mode-linux), a kernel in a
# process: it sees this machine's files read-only, writes to memory ($TMPDIR), and leaves
# nothing behind. Good for function, never for timing.
#
# Exit status: the command's; 124 when it took longer than EPS_HIL_UML_TIMEOUT_S (default 600);
# 125 when no kernel with CAN could be had. EPS_HIL_FORCE_UML=1 skips the machine's own kernel.
set -euo pipefail

if [ $# -eq 0 ]; then
    sed -n '2,12s/^# \{0,1\}//p' "$0" >&2
    exit 2
fi
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
limit_s=${EPS_HIL_UML_TIMEOUT_S:-600}
export EPS_HIL_REQUIRE_SOCKETCAN=1 # who asked for a bus wants no skips

have_vcan0() {
    python3 - <<'PY'
import socket, sys
try:
    with socket.socket(29, socket.SOCK_RAW, 1) as bus:  # AF_CAN, CAN_RAW
        bus.bind(("vcan0",))
except OSError:
    sys.exit(1)
PY
}

make_vcan0() {
    [ "$(id -u)" = 0 ] || return 1
    modprobe -q vcan 2>/dev/null || true
    ip link add dev vcan0 type vcan 2>/dev/null &&
        ip link set vcan0 mtu 72 && ip link set vcan0 up && have_vcan0
}

if [ "${EPS_HIL_FORCE_UML:-0}" != 1 ] && { have_vcan0 || make_vcan0; }; then
    echo "with-vcan: this kernel ($(uname -r)) has SocketCAN, vcan0 is up" >&2
    exec "$@"
fi

uml=$(command -v linux.uml || command -v linux || true)
if [ -z "$uml" ]; then
    echo "with-vcan: this kernel has no SocketCAN (or no vcan0), and User-Mode Linux is missing;" \
        "apt-get install user-mode-linux, or: ip link add dev vcan0 type vcan && ip link set vcan0 mtu 72 up" >&2
    exit 125
fi
modules=/usr/lib/uml/modules/$("$uml" --version)/kernel
if [ ! -d "$modules/net/can" ]; then
    echo "with-vcan: $uml has no CAN modules in $modules; apt-get install user-mode-linux" >&2
    exit 125
fi

work=$(mktemp -d /var/tmp/eps-hil-uml.XXXXXX)
trap 'rm -rf "$work"' EXIT

# The command, its folder and what of the environment makes it the same command.
{
    printf 'cd %q\n' "$PWD"
    printf 'export PATH=%q\n' "$PATH:/usr/sbin:/sbin"
    for name in $(compgen -e); do
        case $name in
        EPS_HIL_* | PYTEST_* | VIRTUAL_ENV | LANG | LC_* | PYENV_*) printf 'export %s=%q\n' "$name" "${!name}" ;;
        esac
    done
    printf 'exec'
    printf ' %q' "$@"
    printf '\n'
} >"$work/command.sh"

# Modules are loaded by hand: kmod looks in /lib/modules, where Debian keeps no UML's.
cat >"$work/modules.py" <<'PY'
import ctypes, lzma, pathlib, sys

libc = ctypes.CDLL(None, use_errno=True)
INIT_MODULE = 175  # x86_64, the only architecture of UML
for wanted in ("net/can/can", "net/can/can-raw", "net/can/can-bcm", "drivers/net/can/dev/can-dev",
               "drivers/net/can/vcan", "drivers/net/can/vxcan"):
    folder = pathlib.Path(sys.argv[1], wanted).parent
    file = next(folder.glob(pathlib.Path(wanted).name + ".ko*"))
    image = file.read_bytes()
    image = lzma.decompress(image) if file.suffix == ".xz" else image
    if libc.syscall(INIT_MODULE, image, ctypes.c_ulong(len(image)), b"") != 0:
        sys.exit(f"{file}: errno {ctypes.get_errno()}")
PY

cat >"$work/init.sh" <<INIT
#!/bin/bash
export PATH=$(printf %q "$PATH"):/usr/sbin:/sbin:/usr/bin:/bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t tmpfs tmpfs /run
mkdir -p /run/tmp /run/home /run/with-vcan /dev/shm
mount -t tmpfs tmpfs /dev/shm
mount -t hostfs -o $work hostfs /run/with-vcan
ip link set lo up
# The tree is read-only: whatever is written goes to memory. /tmp stays as it is, because the
# project itself may lie there.
export TMPDIR=/run/tmp HOME=/run/home PYTHONDONTWRITEBYTECODE=1
# Machine code that this machine has compiled already: the guest would need minutes for it.
mkdir -p /run/home/.cache
cp -r $(printf %q "${XDG_CACHE_HOME:-$HOME/.cache}/eps_hil") /run/home/.cache/ 2>/dev/null || true
export MPLCONFIGDIR=/run/tmp/mpl HYPOTHESIS_STORAGE_DIRECTORY=/run/tmp/hypothesis
export PYTEST_ADDOPTS="-p no:cacheprovider"
python3 $work/modules.py $modules &&
    ip link add dev vcan0 type vcan && ip link set vcan0 mtu 72 && ip link set vcan0 up
status=\$?
echo "@@@ with-vcan"
if [ \$status -eq 0 ]; then
    bash $work/command.sh </dev/null 2>&1
    status=\$?
else
    echo "with-vcan: no vcan0 in User-Mode Linux"
    status=125
fi
echo "@@@ end"
echo \$status >/run/with-vcan/status
sync
echo o >/proc/sysrq-trigger
sleep 30
INIT
chmod +x "$work/init.sh"

# Guest memory is a file: in /dev/shm where there is room, else on disk.
mem_mb=2048
memory=(env -u TMPDIR -u TMP -u TEMP)
shm_mb=$(df --output=avail -m /dev/shm 2>/dev/null | tail -1 || true)
if [ "${shm_mb:-0}" -lt $((mem_mb + 200)) ]; then
    memory=(env -u TMP -u TEMP "TMPDIR=$work")
fi

# Each page of a guest's program may be a map of its own; a large one needs more than the usual 65530.
maps=/proc/sys/vm/max_map_count
if [ "$(cat "$maps" 2>/dev/null || echo 0)" -lt 1048576 ] && [ -w "$maps" ]; then
    { echo 1048576 >"$maps"; } 2>/dev/null || true
fi

# A processor with AMX has a larger register state than this kernel saves (uml_xstate.c says how).
preload=()
if grep -qw amx_tile /proc/cpuinfo; then
    if ! cc -shared -fPIC -O1 -o "$work/uml_xstate.so" "$here/uml_xstate.c"; then
        echo "with-vcan: this processor has AMX, for which User-Mode Linux needs a C compiler;" \
            "apt-get install gcc libc6-dev" >&2
        exit 125
    fi
    preload=("LD_PRELOAD=$work/uml_xstate.so")
fi

echo "with-vcan: User-Mode Linux $("$uml" --version), vcan0 (mtu 72)" >&2
# stdin is the guest's console: without it UML would put the terminal into raw mode
timeout --kill-after=10 "$limit_s" "${memory[@]}" "${preload[@]}" "$uml" rootfstype=hostfs rootflags=/ ro \
    "mem=${mem_mb}M" "init=$work/init.sh" "uml_dir=$work/" umid=guest con=null con0=fd:0,fd:1 \
    </dev/null 2>"$work/kernel.err" | tee "$work/console" |
    awk '/^@@@ end/ {shown = 0} shown {print; fflush()} /^@@@ with-vcan/ {shown = 1}' || true

if [ -s "$work/status" ]; then
    exit "$(cat "$work/status")"
fi
echo "with-vcan: the guest did not finish (limit ${limit_s} s); its last words:" >&2
tail -n 25 "$work/console" "$work/kernel.err" >&2
exit 124
