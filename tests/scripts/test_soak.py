"""A short soak: rig, service, recorder, monitor and listener account for every frame."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_every_frame_of_a_few_seconds_is_accounted_for() -> None:
    words = [sys.executable, str(ROOT / "scripts" / "soak"), "--seconds", "6"]
    words += ["--channel", "239.74.163.118", "--port", "43118"]
    run = subprocess.run(words, check=False, capture_output=True, text=True, timeout=280)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "6 s: every frame is accounted for, and none lost" in run.stdout
    assert run.stdout.count("  ok\n") == 11


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [2_000, 4_000])
def test_every_frame_at_a_higher_rate_is_accounted_for(rate_hz: int) -> None:
    """One run of three with nothing lost: four programs at 4 kHz fill both cores of a small PC."""
    words = [sys.executable, str(ROOT / "scripts" / "soak"), "--seconds", "6"]
    words += ["--rate", str(rate_hz), "--no-monitor"]
    words += ["--channel", "239.74.163.116", "--port", "43116"]
    said = ""
    for _ in range(3):
        run = subprocess.run(words, check=False, capture_output=True, text=True, timeout=280)
        said += run.stdout + run.stderr
        lost = "LOST" in run.stdout  # by a machine that is too busy: then it is tried again
        assert lost or "DOES NOT ADD UP" not in run.stdout, said
        if run.returncode == 0:
            break
    else:
        pytest.fail(said)
    assert "6 s: every frame is accounted for, and none lost" in run.stdout
    steps = int(run.stdout.split("steps", 1)[1].split()[0])
    assert steps == 6 * rate_hz + 20 * rate_hz // 1_000  # the rig's last 20 ms without torque
