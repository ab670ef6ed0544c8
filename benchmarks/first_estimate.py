#!/usr/bin/env python3
"""The first `eps-hil estimate` after installation beside one with everything compiled.

    python benchmarks/first_estimate.py

Processes of their own on the same CSV of 10 s. The first has an empty cache of compiled functions,
and is interpreted; what it has compiled in the background is waited for. Exit status 1 if the two
do not write the same bytes. Processor seconds (user and system) of the process itself say what it
costs on any machine; a busy one takes longer by the clock.
"""

import fcntl
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from batch_estimator import ROOT, recording

from eps_hil.physics.model import load_model
from eps_hil.recordings.write import write_table

MODEL = ROOT / "configs/reference_rig.yaml"
PATIENCE_S = 900.0


def run(folder: Path, out: str) -> tuple[float, float]:
    """One process: (seconds by the clock, processor seconds)."""
    environment = os.environ | {"XDG_CACHE_HOME": str(folder), "PYTHONPATH": str(ROOT)}
    environment.pop("NUMBA_CACHE_DIR", None)  # a place of its own would hold what is compiled
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "eps_hil.cli", "estimate", str(folder / "drive.csv"),
         "--model", str(MODEL), "--out", str(folder / out)],
        check=True, stdout=subprocess.DEVNULL, cwd=ROOT,
        env=environment,
    )  # fmt: skip
    took = time.perf_counter() - begun
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return took, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> int:
    """Run both, say what came out."""
    with tempfile.TemporaryDirectory() as folder:
        series = recording(load_model(MODEL), 10.0)
        stamps = series["motor_speed_rad_s"].t_ns
        columns = {name: one.value for name, one in series.items()}
        write_table(Path(folder) / "drive.csv", columns, t_ns=stamps)
        begun = time.perf_counter()
        first, first_cpu = run(Path(folder), "first.csv")
        while not list(Path(folder).rglob("*.take_and_advance-*.nbi")):
            time.sleep(0.2)
            if time.perf_counter() - begun > PATIENCE_S:
                print("nothing was compiled in the background")
                return 1
        ready = time.perf_counter() - begun
        second, second_cpu = run(Path(folder), "second.csv")
        (lock,) = Path(folder).rglob("ahead.lock")
        with lock.open() as held:  # nothing goes on when this ends
            fcntl.flock(held, fcntl.LOCK_EX)
        same = (Path(folder) / "first.csv").read_bytes() == (
            Path(folder) / "second.csv"
        ).read_bytes()
    print(f"first  {first:6.1f} s, {first_cpu:6.1f} processor seconds")
    print(f"later  {second:6.1f} s, {second_cpu:6.1f} processor seconds")
    print(f"compiled {ready:.0f} s after the first began; {'same bytes' if same else 'DIFFERENT'}")
    return int(not same)


if __name__ == "__main__":
    sys.exit(main())
