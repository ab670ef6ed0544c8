#!/usr/bin/env python3
"""The first `eps-hil estimate` after installation beside the second one.

    python benchmarks/first_estimate.py

Both are processes of their own on the same CSV of 10 s; the first has an empty cache of compiled
functions. Processor seconds (user and system) say what compiling costs on any machine; a busy one
takes longer by the clock.
"""

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


def run(folder: Path) -> tuple[float, float]:
    """One process: (seconds by the clock, processor seconds)."""
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "eps_hil.cli", "estimate", str(folder / "drive.csv"),
         "--model", str(MODEL), "--out", str(folder / "out.csv")],
        check=True, stdout=subprocess.DEVNULL, cwd=ROOT,
        env=os.environ | {"XDG_CACHE_HOME": str(folder), "PYTHONPATH": str(ROOT)},
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
        (first, first_cpu), (second, second_cpu) = run(Path(folder)), run(Path(folder))
    print(f"first  {first:6.1f} s, {first_cpu:6.1f} processor seconds")
    print(f"second {second:6.1f} s, {second_cpu:6.1f} processor seconds")
    print(f"ratio {first_cpu / second_cpu:.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
