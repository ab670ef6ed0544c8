# shellcheck shell=bash
# The checkout's own Python environment, made once. Sourced by the other scripts:
#
#     source "$(dirname "${BASH_SOURCE[0]}")/_environment.sh"
#     prepare_environment all        # an extra of pyproject.toml: all (to use it), dev (to work on it),
#                                    # dashboard (the quickest that moves; the rest can come later)
#
# Afterwards $ROOT is the checkout, the working directory is $ROOT, and `python` and `eps-hil` on PATH
# are the environment's. It lives in $ROOT/.venv; an environment that happens to be active is left
# alone, so that nothing gets installed where nobody asked for it. To use a Python of your own that
# has everything already, set EPS_HIL_PYTHON=/path/to/python; nothing is installed then.
#
# What was installed is remembered (a digest of the Python, the checkout's place and what
# pyproject.toml asks for), so that a second run installs nothing and needs no network.

ROOT="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)"
VENV="$ROOT/.venv"
unset PYTHONHOME PYTHONPATH # another project's packages must not shadow ours

say() { printf '==> %s\n' "$*"; }
fail() {
    printf 'error: %s\n' "$*" >&2
    exit 1
}

# Whether $1 runs (a pyenv shim may be there and not run) and is Python 3.11 or newer.
_is_suitable() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; }

# An environment that was moved has programs that start a Python which is no longer there.
_is_in_place() { head -n 3 "$VENV/bin/pip" 2>/dev/null | grep -qF "$VENV/bin/"; }

_has_pip() { "$1" -m pip --version >/dev/null 2>&1; }

# Debian's python3 has `venv` but, without the package python3-venv, not what puts pip into it.
_can_make_venv() { "$1" -c 'import venv, ensurepip' >/dev/null 2>&1 || _has_pip "$1"; }

# Prints the Python to build with; returns 1 if there is none, 2 if it could not make an environment.
_find_python() {
    local name path unable=""
    for name in python3.13 python3.12 python3.11 python3 python; do
        while IFS= read -r path; do
            _is_suitable "$path" || continue
            if _can_make_venv "$path"; then
                printf '%s\n' "$path"
                return 0
            fi
            unable="${unable:-$path}"
        done < <(type -aP "$name" || true)
    done
    printf '%s\n' "$unable"
    if [[ -n $unable ]]; then return 2; else return 1; fi
}

_version() { "$1" -c 'import platform; print(platform.python_version())'; }

_make_venv() {
    local python status=0
    python="$(_find_python)" || status=$?
    case $status in
    1) fail "no Python 3.11 or newer found; install one (Debian, Ubuntu: sudo apt install python3 python3-venv)" ;;
    2) fail "$python cannot make an environment; install its venv module: sudo apt install python$(_version "$python" | cut -d. -f1,2)-venv" ;;
    esac
    say "making an environment in .venv with Python $(_version "$python") ($python)"
    rm -rf "$VENV"
    if "$python" -c 'import ensurepip' >/dev/null 2>&1; then
        "$python" -m venv "$VENV" || fail "'$python -m venv $VENV' failed, see above"
    else # a pip outside can put one inside
        "$python" -m venv --without-pip "$VENV" || fail "'$python -m venv $VENV' failed, see above"
        "$python" -m pip --quiet --python "$VENV/bin/python" install pip ||
            fail "no pip for the environment; install $python's venv module (Debian: python3-venv)"
    fi
}

# What an installation depends on; the tools' settings in pyproject.toml do not count.
_digest() {
    "$VENV/bin/python" - "$ROOT" <<'PYTHON'
import hashlib, json, pathlib, sys, tomllib

root = pathlib.Path(sys.argv[1])
project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
asked = [sys.version, str(root), project["build-system"], project["project"]]
print(hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest())
PYTHON
}

_is_installed() { # extra, digest; `all` holds all that dashboard has, and dev all that `all` has
    local extra holders=("$1" dev)
    [[ $1 != dashboard ]] || holders+=(all)
    for extra in "${holders[@]}"; do
        [[ "$(cat "$VENV/.eps_hil-$extra" 2>/dev/null)" == "$2" ]] && return 0
    done
    return 1
}

# While the rest of the caller runs, on a terminal: how long it has taken, and what pip is at.
_ticker=""
_tick() { # seconds when it began, pip's log
    [[ -t 1 ]] || return 0
    (
        while kill -0 $$ 2>/dev/null; do
            printf '\r\033[K    %s s  %.60s' $((SECONDS - $1)) "$(tail -n 1 "$2" 2>/dev/null)"
            sleep 1
        done
    ) &
    _ticker=$!
}
_untick() {
    [[ -n $_ticker ]] || return 0
    kill "$_ticker" 2>/dev/null || true
    wait "$_ticker" 2>/dev/null || true
    _ticker=""
    printf '\r\033[K'
}

# uv takes much less time than pip. What pip was told (mirror, certificates, constraints) it is told, too.
_uv() { # log, then what uv is to install
    local log="$1" line uv
    shift
    uv="$(command -v uv)" || uv="$VENV/bin/uv"
    [[ -x $uv ]] || "$VENV/bin/python" -m pip install --quiet --no-compile uv >"$log" 2>&1 || return 1
    (
        while IFS= read -r line; do
            case "${line%%=*}" in
            *.index-url) export UV_DEFAULT_INDEX="${UV_DEFAULT_INDEX:-$(_quoted "$line")}" ;;
            *.extra-index-url) export UV_INDEX="${UV_INDEX:-$(_quoted "$line")}" ;;
            *.find-links) export UV_FIND_LINKS="${UV_FIND_LINKS:-$(_quoted "$line" | tr ' ' ',')}" ;;
            *.constraint) export UV_CONSTRAINT="${UV_CONSTRAINT:-$(_quoted "$line")}" ;;
            *.cert) export SSL_CERT_FILE="${SSL_CERT_FILE:-$(_quoted "$line")}" ;;
            esac
        done < <("$VENV/bin/python" -m pip config list 2>/dev/null)
        export UV_INDEX_STRATEGY="${UV_INDEX_STRATEGY:-unsafe-best-match}" # as pip does it
        exec "$uv" --no-progress pip install --python "$VENV/bin/python" "$@" >"$log" 2>&1
    )
}
_quoted() { sed "s/^[^']*'//; s/'[^']*\$//" <<<"$1"; } # the value of a line of `pip config list`

_pip() { # log, then what pip is to install
    local log="$1"
    shift
    PIP_USER=0 "$VENV/bin/python" -m pip install --disable-pip-version-check --no-compile \
        --progress-bar off "$@" >"$log" 2>&1
}

# Python compiles what it imports when it imports it. Where it may not (PYTHONDONTWRITEBYTECODE) each
# process would do so anew: in the background, what eps-hil imports of others, in .venv alone.
_keep_bytecode() {
    [[ -n ${PYTHONDONTWRITEBYTECODE:-} ]] || return 0
    (
        cd /
        exec env -u PYTHONDONTWRITEBYTECODE nice "$VENV/bin/python" - <<'PYTHON' >/dev/null 2>&1
import contextlib, importlib

for name in (
    "numba scipy.optimize scipy.signal scipy.linalg scipy.interpolate scipy.stats scipy.ndimage "
    "pydantic typer rich.table rich.live rich.progress yaml can can.interfaces.udp_multicast cantools "
    "fastcrc matplotlib.pyplot jinja2 pyarrow.parquet uvicorn starlette.applications websockets asammdf"
).split():
    with contextlib.suppress(ImportError):
        importlib.import_module(name)
PYTHON
    ) 9<&- & # the lock of prepare_environment is not its
}

_install() { # extra, digest
    local log="$VENV/.eps_hil-install.log" since=$SECONDS
    say "installing eps_hil[$1] and what it needs into .venv (needs the network, once; about a minute)"
    _tick "$since" "$log"
    if ! _uv "$log" --editable "${ROOT}[$1]" && ! _pip "$log" --editable "${ROOT}[$1]"; then
        _untick
        tail -n 15 "$log" >&2
        fail "pip could not install eps_hil[$1] (whole log: $log); is the network there?"
    fi
    _untick
    _keep_bytecode
    printf '%s\n' "$2" >"$VENV/.eps_hil-$1"
    say "installed in $((SECONDS - since)) s"
}

_prepare_venv() { # extra
    local digest
    if ! _is_suitable "$VENV/bin/python" || ! _has_pip "$VENV/bin/python" || ! _is_in_place; then
        [[ ! -e $VENV ]] || say ".venv is broken, moved, or older than Python 3.11: making it anew"
        _make_venv
    fi
    digest="$(_digest)"
    if _is_installed "$1" "$digest"; then
        say "environment: .venv, Python $(_version "$VENV/bin/python"), already installed"
    else
        _install "$1" "$digest"
    fi
    export VIRTUAL_ENV="$VENV" PATH="$VENV/bin:$PATH"
}

prepare_environment() { # extra
    cd "$ROOT" || exit 1
    if [[ -n ${EPS_HIL_PYTHON:-} ]]; then
        "$EPS_HIL_PYTHON" -c 'import eps_hil' >/dev/null 2>&1 ||
            fail "EPS_HIL_PYTHON=$EPS_HIL_PYTHON cannot import eps_hil; install it there or unset the variable"
        say "environment: $EPS_HIL_PYTHON (EPS_HIL_PYTHON), as it is"
        PATH="$("$EPS_HIL_PYTHON" -c 'import sysconfig; print(sysconfig.get_path("scripts"))'):$PATH"
        export PATH
        return
    fi
    if command -v flock >/dev/null 2>&1; then # two scripts at once must not install at once
        exec 9<"$ROOT/pyproject.toml"
        flock -n 9 || { say "another script prepares the environment, waiting for it" && flock 9; }
        _prepare_venv "$1"
        exec 9<&-
    else
        _prepare_venv "$1"
    fi
}
