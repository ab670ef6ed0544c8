#!/usr/bin/env python3
"""`eps-hil estimate` on a CSV beside pyarrow's read and write of the same tables.

    python benchmarks/estimate_csv.py --seconds 624

In this process, by turns, the shortest of --runs: the recording is read, estimated and the
estimates written as CSV; the peer reads the recording's table and writes the estimates' table by
pyarrow alone, and estimates nothing. What is written is read back and compared. Exit status 1 if it
differs, or if the ratio is above --limit.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow.csv
from batch_estimator import ROOT, recording

from eps_hil.estimation.batch import estimate
from eps_hil.physics.model import load_model
from eps_hil.recordings.read import read_recording
from eps_hil.recordings.write import write_table


def main() -> int:
    """Run both, say what came out."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--seconds", type=float, default=624.0)
    ask.add_argument("--runs", type=int, default=3)
    ask.add_argument("--limit", type=float, default=float("inf"), help="exit 1 above this ratio")
    chosen = ask.parse_args()
    model = load_model(ROOT / "configs/reference_rig.yaml")
    best = {"read": np.inf, "estimate": np.inf, "write": np.inf, "pyarrow": np.inf}

    def took(name: str, since: float) -> float:
        now = time.perf_counter()
        best[name] = min(best[name], now - since)
        return now

    with tempfile.TemporaryDirectory() as folder:
        drive, ours, peer = (Path(folder) / name for name in ("drive.csv", "out.csv", "peer.csv"))
        series = recording(model, chosen.seconds)
        stamps = series["motor_speed_rad_s"].t_ns
        write_table(drive, {name: one.value for name, one in series.items()}, t_ns=stamps)
        estimate(read_recording(drive).series, model)  # compiles
        for _ in range(chosen.runs):
            at = time.perf_counter()
            read = read_recording(drive)
            at = took("read", at)
            trace = estimate(read.series, model)
            at = took("estimate", at)
            columns = {
                "rack_force_estimate_n": trace.rack_force_n,
                "friction_torque_nm": trace.friction_torque_nm,
                "valid": trace.valid,
            }
            write_table(ours, columns, t_ns=trace.t_ns)
            at = took("write", at)
            pyarrow.csv.read_csv(drive)
            table = pyarrow.table({"time_s": trace.t_ns * 1e-9, **columns})
            pyarrow.csv.write_csv(table, peer)
            took("pyarrow", at)
        back = read_recording(ours).series
        same = np.array_equal(back["rack_force_estimate_n"].value, trace.rack_force_n)
        same &= np.array_equal(back["rack_force_estimate_n"].t_ns, trace.t_ns)
    mine = best["read"] + best["estimate"] + best["write"]
    for name, seconds in best.items():
        print(f"{name:9} {seconds * 1e3:8.1f} ms")
    print(f"ratio {mine / best['pyarrow']:.2f}; read back {'the same' if same else 'DIFFERENT'}")
    return int(not same or mine / best["pyarrow"] > chosen.limit)


if __name__ == "__main__":
    sys.exit(main())
