#!/usr/bin/env bash
# The package as a user gets it: builds wheel and sdist, installs the wheel into an empty environment
# outside the checkout, and works in an empty folder with nothing but what `eps-hil example` writes.
#
#     scripts/ci/wheel.sh [FOLDER]      FOLDER: where to work and leave everything (default: a new one)
#
# What --help and `eps-hil example` say to run, as they say it: a simulated rig, the service and the
# recorder on UDP multicast, then diagnose and its page. Beside it convert, compare, budget,
# reproduce --quick and one concealed case. Machine code that this user has compiled before is used
# again (eps_hil/compiled.py knows it by its source). Exit status 0 only if all of it worked.
set -euo pipefail
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd -P)"
unset PYTHONHOME PYTHONPATH VIRTUAL_ENV
started=$SECONDS
kept="${1:-}"
work="${kept:-$(mktemp -d)}"
mkdir -p "$work"
work="$(cd "$work" && pwd -P)"
pids=()
finish() {
    for pid in "${pids[@]}"; do kill "$pid" 2>/dev/null || true; done
    [[ -n $kept ]] || rm -rf "$work"
}
trap finish EXIT
say() { printf 'wheel: %4d s  %s\n' $((SECONDS - started)) "$*"; }
fail() {
    printf 'wheel: FAILED: %s\n' "$*" >&2
    exit 1
}
log() { # file, command: its words only if it fails
    local file="$work/$1.txt"
    shift
    "$@" >"$file" 2>&1 || { tail -n 25 "$file" >&2 && fail "$*"; }
}

python=python3
if [[ -x $root/.venv/bin/python ]]; then python="$root/.venv/bin/python"; fi
mkdir "$work/source" "$work/empty"
git -C "$root" ls-files -z | tar -C "$root" --create --null --files-from=- |
    tar -C "$work/source" --extract
say "an empty environment"
log venv "$python" -m venv "$work/venv"
pip=("$work/venv/bin/python" -m pip --disable-pip-version-check --quiet)
log build "${pip[@]}" wheel --no-deps --wheel-dir "$work/dist" "$work/source"
log tools "${pip[@]}" install 'setuptools>=77'
(cd "$work/source" && log sdist "$work/venv/bin/python" -c \
    "from setuptools.build_meta import build_sdist; build_sdist('$work/dist')")
wheel=("$work"/dist/*.whl)
sdist=("$work"/dist/*.tar.gz)
for file in configs/demo_udp.yaml configs/manoeuvres/demo.yaml configs/programmes/short.yaml \
    dbc/eps_rig.dbc; do
    "$python" -m zipfile --list "${wheel[0]}" | grep "eps_hil/examples/$file" >/dev/null ||
        fail "the wheel lacks $file"
    tar --list --file "${sdist[0]}" | grep "eps_hil/examples/$file" >/dev/null ||
        fail "the sdist lacks $file"
done
say "installing $(basename "${wheel[0]}")"
log install "${pip[@]}" install "${wheel[0]}[report]"

cd "$work/empty"
eps=("$work/venv/bin/eps-hil")
log version "${eps[@]}" --version
[[ $("$work/venv/bin/python" -c 'import eps_hil; print(eps_hil.__file__)') == "$work"/venv/* ]] ||
    fail "another eps_hil than the wheel's was imported"

# What a newcomer does who has nothing but --help: it names `example`, which says what to run.
log help "$work/venv/bin/python" -m eps_hil --help
grep -q 'eps-hil example demo_udp' "$work/help.txt" || fail "--help does not say where to begin"
log example "${eps[@]}" example demo_udp
mapfile -t told < <(sed -n 's/^run: \(eps-hil [^ ]*.*\)$/\1/p' "$work/example.txt" | sed 's/     .*//')
[[ ${told[*]} == "eps-hil rig "*" eps-hil run "*" eps-hil record "*" eps-hil diagnose "* ]] ||
    fail "the example says to run ${told[*]}"
as_told() { # which, then words more: starts what was said
    local words
    read -ra words <<<"${told[$1]}"
    shift
    PATH="$work/venv/bin:$PATH" exec "${words[@]}" "$@"
}

say "rig, service and recorder on a bus"
sed -i 's/239.74.163.2$/239.74.163.77/; s/43113/43177/' configs/demo_udp.yaml # nobody else's
as_told 0 >"$work/rig.txt" 2>&1 &
pids=($!)
as_told 1 --log-estimates live.csv >"$work/run.txt" 2>&1 &
pids+=($!)
for file in rig run; do
    for ((i = 0; i < 3000; i++)); do
        grep -q '^READY' "$work/$file.txt" 2>/dev/null && continue 2
        sleep 0.1
    done
    cat "$work/$file.txt" >&2
    fail "$file is not ready after five minutes"
done
(as_told 2 --duration 14 >"$work/record.txt" 2>&1) || { cat "$work/record.txt" >&2 && fail "the recorder"; }
kill -TERM "${pids[@]}"
for name in rig run; do
    wait "${pids[0]}" || { cat "$work/$name.txt" >&2 && fail "$name"; }
    pids=("${pids[@]:1}")
done
grep -E '^(done|steps|recorded)' "$work/rig.txt" "$work/run.txt" "$work/record.txt" -h

say "budget, one concealed case; beside them reproduce --quick"
"${eps[@]}" reproduce --quick --out reproduction >"$work/reproduce.txt" 2>&1 &
pids=($!)
log budget "${eps[@]}" budget --model configs/reference_rig.yaml --order 1 --draws 4
log prove "${eps[@]}" prove concealed --quick --cases 1 --jobs 1
say "diagnose, convert"
can=(--dbc dbc/eps_rig.dbc --signals configs/eps_rig_signals.yaml)
(as_told 3 --json diagnosis.json >"$work/diagnose.txt" 2>&1) ||
    { tail -n 25 "$work/diagnose.txt" >&2 && fail "diagnose"; }
head -n 6 "$work/diagnose.txt"
grep -q '^page: page.html' "$work/diagnose.txt" || fail "diagnose does not say where its page is"
grep -q 'dropped_frames' diagnosis.json && fail "the diagnosis tells of frames that nobody lost"
sed -n 's|.* id="verdict">\(.*\)</p>.*|\1|p' page.html | tee "$work/headline.txt"
[[ -s $work/headline.txt ]] || fail "the page has no headline"
log convert "${eps[@]}" convert bus.log rig.csv "${can[@]}"
log compare "${eps[@]}" compare rig.csv --model configs/reference_rig.yaml --figure force.png
wait "${pids[0]}" || { tail -n 25 "$work/reproduce.txt" >&2 && fail "reproduce"; }
pids=()
for file in page.html force.png live.csv concealed_quick_1/index.html reproduction/index.html; do
    [[ -s $file ]] || fail "$file was not written"
done
say "all worked"
