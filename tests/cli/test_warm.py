"""The process that diagnoses case after case: it does not outlive whoever started it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

STARTER = """
import os, subprocess, sys
warm = subprocess.Popen(
    [sys.executable, "-c", sys.argv[2]], stdin=int(sys.argv[1]), stdout=subprocess.DEVNULL
)
print(warm.pid, flush=True)
warm.wait()
"""

WITHOUT_END = """
import time
import eps_hil.cli.main as verbs
from eps_hil.cli._warm import serve

def main(words):
    if words[0] == "waits":
        time.sleep(float(words[1]))
        return 0
    while True:
        pass

verbs.main = main
serve()
"""


def children(pid: int) -> list[int]:
    return [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def alive(pid: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):  # gone before it was opened, or read
        return False


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux' /proc")
@pytest.mark.slow
def test_it_ends_with_its_parent_and_takes_the_case_in_work_along(tmp_path: Path) -> None:
    """The case here takes ten minutes."""
    reading, writing = os.pipe()
    parent = subprocess.Popen(
        [sys.executable, "-c", STARTER, str(reading), WITHOUT_END],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        pass_fds=(reading,),
    )
    os.close(reading)
    assert parent.stdout is not None
    warm = int(parent.stdout.readline())
    words = ["waits", "600"]
    os.write(writing, (json.dumps([str(tmp_path), 600.0, words]) + "\n").encode())
    end = time.monotonic() + 60.0
    while not (found := children(warm)) or not (tmp_path / "stderr.txt").exists():
        assert time.monotonic() < end, [one.read_text() for one in tmp_path.glob("std*.txt")]
        time.sleep(0.05)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    end = time.monotonic() + 10.0
    while alive(warm) or any(map(alive, found)):
        assert time.monotonic() < end, "it goes on without anybody to tell"
        time.sleep(0.05)
    os.close(writing)
    assert parent.stderr is not None
    assert parent.stderr.read() == ""


@pytest.mark.slow
def test_processor_time_is_what_is_limited(tmp_path: Path) -> None:
    """On a machine that others use too a case waits; one that computes without end is given up."""
    warm = subprocess.Popen(
        [sys.executable, "-c", WITHOUT_END],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert warm.stdin is not None
    assert warm.stdout is not None
    for words in (["computes"], ["waits", "1.5"]):
        warm.stdin.write(json.dumps([str(tmp_path), 1.0, words]) + "\n")
    warm.stdin.close()
    assert [json.loads(one) for one in warm.stdout] == [None, 0]
    assert warm.wait(10.0) == 0


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux' /proc")
def test_ctrl_c_ends_it_without_a_word() -> None:
    """A terminal sends it to all; what was interrupted is told by who started it."""
    warm = subprocess.Popen(
        [sys.executable, "-m", "eps_hil.cli._warm"], stdin=subprocess.PIPE, stderr=subprocess.PIPE
    )
    until, caught = time.monotonic() + 30.0, True
    while caught and time.monotonic() < until:  # Python's own handler, which raises
        time.sleep(0.5)
        (mask,) = (
            line.split()[1]
            for line in Path(f"/proc/{warm.pid}/status").read_text().splitlines()
            if line.startswith("SigCgt:")
        )
        caught = bool(int(mask, 16) & 1 << (signal.SIGINT - 1))
    assert not caught
    warm.send_signal(signal.SIGINT)
    _, said = warm.communicate(timeout=30.0)
    assert said == b""
    assert warm.returncode == -signal.SIGINT
