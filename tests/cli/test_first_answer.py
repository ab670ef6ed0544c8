"""The first estimate after installation waits for no compiler."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from eps_hil.cli.main import main
from eps_hil.recordings.write import write_table

MODEL = str(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")
PROGRAM = """
import subprocess, sys
started = []
subprocess.Popen = lambda words, **_: started.append(words)  # what would compile meanwhile
from eps_hil.cli.main import main
status = main(sys.argv[1:])
from eps_hil.compiled import interpreted
print(status, interpreted(), [words[-1] for words in started])
"""


def test_it_is_interpreted_and_the_same(tmp_path: Path) -> None:
    n = 1_500
    t = np.arange(n) * 1e-3
    speed = 12.0 * np.sin(2 * np.pi * t)
    noise = np.random.default_rng(7).normal(0, 1e-2, (3, n))
    columns = {
        "motor_torque_nm": 0.2 * np.sin(2 * np.pi * t) + noise[0],
        "motor_speed_rad_s": speed + 10 * noise[1],
        "motor_angle_rad": np.cumsum(speed) * 1e-3 + 0.1 * noise[2],
    }
    drive = tmp_path / "drive.csv"
    write_table(drive, columns, t_ns=np.arange(n, dtype=np.int64) * 1_000_000)
    words = ["estimate", str(drive), "--model", MODEL, "--out"]
    cold = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cold"), "NUMBA_CACHE_DIR": ""}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *words, str(tmp_path / "first.csv")],
        env=cold, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.splitlines()[-1] == "0 True ['eps_hil.estimation.ahead']"
    assert main([*words, str(tmp_path / "later.csv")]) == 0
    assert (tmp_path / "first.csv").read_bytes() == (tmp_path / "later.csv").read_bytes()
