"""What the shell is told when somebody presses Tab; file names are the shell's own."""

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("eps-hil dia", ["diagnose"]),
        ("eps-hil batch ", ["diagnose", "estimate", "identify"]),
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
