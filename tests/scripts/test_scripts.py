"""The shell scripts: clean under shellcheck, run from anywhere, and say what is wrong."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = [ROOT / "scripts" / name for name in ("_environment.sh", "test", "demo", "demo-diagnose")]


@pytest.mark.skipif(shutil.which("shellcheck") is None, reason="shellcheck is not installed")
def test_shellcheck_has_nothing_to_say() -> None:
    found = subprocess.run(
        ["shellcheck", "-x", *SCRIPTS], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert found.returncode == 0, found.stdout


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_bash_can_read_it(script: Path) -> None:
    subprocess.run(["bash", "-n", script], check=True)


def test_the_demo_refuses_an_unknown_bus(tmp_path: Path) -> None:
    found = subprocess.run(
        [ROOT / "scripts" / "demo", "flexray"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 1
    assert found.stderr == "error: 'flexray' is no bus: write scripts/demo [udp|vcan]\n"


def _copy_of_scripts(folder: Path) -> Path:
    shutil.copytree(ROOT / "scripts", folder / "scripts")
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder / "scripts" / "demo"


def _path_with(folder: Path, **programs: str) -> dict[str, str]:
    """An environment whose PATH has the shell's usual tools, and for Python only ``programs``."""
    tools = folder / "bin"
    tools.mkdir()
    for name in ("bash", "dirname", "cut", "cat", "flock", "tail", "rm", "env"):
        where = shutil.which(name)
        if where is not None:
            (tools / name).symlink_to(where)
    for name, text in programs.items():
        (tools / name).write_text(text, encoding="utf-8")
        (tools / name).chmod(0o755)
    return {"PATH": str(tools), "HOME": str(folder)}


def test_no_suitable_python_is_said_in_one_line(tmp_path: Path) -> None:
    demo = _copy_of_scripts(tmp_path)
    shim = "#!/bin/sh\necho 'python3: command not found in this version' >&2\nexit 127\n"
    found = subprocess.run(
        [demo],
        env=_path_with(tmp_path, python3=shim),
        cwd="/",
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 1
    assert found.stderr.startswith("error: no Python 3.11 or newer found; install one")
    assert found.stderr.count("\n") == 1


def test_a_python_without_venv_is_said_in_one_line(tmp_path: Path) -> None:
    """As Debian's python3 without python3-venv and without pip."""
    demo = _copy_of_scripts(tmp_path)
    python = """#!/bin/sh
case "$*" in
    *version_info*) exit 0 ;;
    *python_version*) echo 3.12.4 ;;
    *) exit 1 ;;
esac
"""
    found = subprocess.run(
        [demo],
        env=_path_with(tmp_path, python3=python),
        cwd="/",
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 1
    assert "sudo apt install python3.12-venv" in found.stderr
    assert found.stderr.count("\n") == 1


def test_a_python_of_ones_own_must_have_the_package(tmp_path: Path) -> None:
    demo = _copy_of_scripts(tmp_path)
    found = subprocess.run(
        [demo],
        env=os.environ | {"EPS_HIL_PYTHON": "/bin/false"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 1
    assert "EPS_HIL_PYTHON=/bin/false cannot import eps_hil" in found.stderr


def test_whoever_waits_for_pip_sees_what_it_is_at(tmp_path: Path) -> None:
    """On a terminal; a file of what was said gets no such line."""
    (tmp_path / "log").write_text("Collecting numpy\nCollecting scipy\n")
    words = 'set -euo pipefail; source "$1"; _tick $SECONDS log; read -r; _untick; echo there'
    command = ["bash", "-c", words, "bash", str(ROOT / "scripts" / "_environment.sh")]
    ours, theirs = os.openpty()
    with subprocess.Popen(command, cwd=tmp_path, stdin=subprocess.PIPE, stdout=theirs) as waiting:
        seen = ""
        while "scipy" not in seen:
            seen += os.read(ours, 4096).decode()
        waiting.communicate(b"\n")
    while "there" not in seen:
        seen += os.read(ours, 4096).decode()
    os.close(ours)
    os.close(theirs)
    assert waiting.returncode == 0
    assert re.search(r"\r\x1b\[K    \d+ s  Collecting scipy.*\r\x1b\[Kthere", seen), seen
    to_file = subprocess.run(
        command, cwd=tmp_path, input="\n", capture_output=True, text=True, check=True
    )
    assert (to_file.stdout, to_file.stderr) == ("there\n", "")


_FAKE_PYTHON = """#!/bin/sh
case "$*" in
    *"config list"*) echo "global.index-url='https://mirror/simple'"
                     echo "global.extra-index-url='https://a https://b'"
                     echo ":env:.find-links='/x /y'" ;;
    *) echo "pip $*" >>"$SAID" ;;
esac
"""
_FAKE_UV = """#!/bin/sh
echo "uv $* $UV_DEFAULT_INDEX $UV_INDEX $UV_FIND_LINKS" >>"$SAID"
exit $STATUS
"""


@pytest.mark.parametrize("status", [0, 2])
def test_uv_is_told_what_pip_was_told_and_where_it_fails_pip_installs(
    status: int, tmp_path: Path
) -> None:
    folder = tmp_path / "bin"
    folder.mkdir()
    for name, text in (("python", _FAKE_PYTHON), ("uv", _FAKE_UV)):
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    words = 'set -euo pipefail; source "$1"; VENV="$2"; _install dev digest'
    script = str(ROOT / "scripts" / "_environment.sh")
    told = {"SAID": str(tmp_path / "said"), "STATUS": str(status)}
    env = {name: value for name, value in os.environ.items() if not name.startswith("UV_")}
    env |= told | {"PATH": f"{folder}:{env['PATH']}", "PYTHONDONTWRITEBYTECODE": ""}
    done = subprocess.run(
        ["bash", "-c", words, "bash", script, str(tmp_path)],
        env=env, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "installed in" in done.stdout
    first, *more = (tmp_path / "said").read_text().splitlines()
    assert first.startswith("uv --no-progress pip install --python")
    assert first.endswith(f"--editable {ROOT}[dev] https://mirror/simple https://a https://b /x,/y")
    assert len(more) == (status != 0)
    assert not more or (more[0].startswith("pip -m pip install") and f"{ROOT}[dev]" in more[0])
    assert (tmp_path / ".eps_hil-dev").read_text() == "digest\n"


@pytest.mark.slow
def test_record_kill_measures_and_prints_a_row() -> None:
    words = [sys.executable, str(ROOT / "scripts" / "record_kill"), "--runs", "1"]
    run = subprocess.run(
        [*words, "--format", ".log"], capture_output=True, text=True, timeout=120, check=False
    )
    assert run.returncode == 0, run.stderr
    row = run.stdout.splitlines()[-1]
    left = re.findall(r"(\d+\.\d) %", row)
    assert row.startswith("| `.log` | 1 |")
    assert 50.0 < float(left[1]) <= float(left[0]) <= 100.0
