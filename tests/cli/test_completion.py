"""What the shell is told when somebody presses Tab; file names are the shell's own."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("eps-hil dia", ["diagnose"]),
        ("eps-hil batch ", ["changes", "diagnose", "estimate", "identify"]),
        ("eps-hil diagnose --rec", ["--recording"]),
        ("eps-hil diagnose --recording dr", []),
        ("eps-hil example calibrate", ["calibrate_udp", "calibrate_vcan"]),
        ("eps-hil diagnose --without-effect stri", ["stribeck"]),
    ],
)
def test_what_may_follow(words: str, said: list[str]) -> None:
    told = subprocess.run(
        [sys.executable, "-m", "eps_hil"],
        env={
            **os.environ,
            "_EPS_HIL_COMPLETE": "complete_bash",
            "COMP_WORDS": words,
            "COMP_CWORD": str(words.count(" ")),
        },
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert sorted(told.stdout.split()) == said, told.stderr


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize("there", [True, False])
def test_bash_says_nothing_where_the_program_is_not(there: bool, tmp_path: Path) -> None:
    """An environment that is not active: Tab falls back to file names, without a complaint."""
    if there:
        program = tmp_path / "eps-hil"
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m eps_hil "$@"\n')
        program.chmod(0o755)
    script = subprocess.run(
        [sys.executable, "-m", "eps_hil", "--show-completion", "bash"],
        env={**os.environ, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    pressed = "COMP_WORDS=(eps-hil dia); COMP_CWORD=1; _eps_hil_completion eps-hil"
    pressed += '; echo "${COMPREPLY[@]}"'
    told = subprocess.run(
        ["bash", "--norc", "-c", f"{script.stdout}\n{pressed}"],
        env={**os.environ, "PATH": f"{tmp_path}:/usr/bin:/bin"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert told.stdout.split() == (["diagnose"] if there else [])
    assert told.stderr == ""


def test_each_shell_looks_for_the_program_first() -> None:
    for shell, said in {"zsh": "command -v eps-hil", "fish": "command -q eps-hil; and"}.items():
        script = subprocess.run(
            [sys.executable, "-m", "eps_hil", "--show-completion", shell],
            env={**os.environ, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"},
            capture_output=True, text=True, check=True,
        ).stdout  # fmt: skip
        assert said in script
