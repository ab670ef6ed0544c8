"""The batch estimator has not become slower: instructions are counted, no clock is read."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "instructions.py"
LIMIT = 5.5
"""Times the C program's count: 4.46 on 2026-11-24; 6.93 when its kernels were calls."""


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("valgrind") is None or shutil.which("cc") is None,
    reason="needs valgrind and a C compiler",
)
def test_no_more_instructions_a_step() -> None:
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--limit", str(LIMIT)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
