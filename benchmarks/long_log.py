#!/usr/bin/env python3
"""`eps-hil estimate` on a log of a night: how long a gigabyte takes, and how much memory.

    python benchmarks/long_log.py --gb 10                   candump
    python benchmarks/long_log.py --gb 10 --suffix .mf4     MF4 bus logging, not compressed

The log (1 kHz, counters and CRC right) is two minutes of decode_log.py's traffic again and
again, at later stamps; it is written to --folder, as are the estimates (Parquet). What grows
with the log lies in a file that the system pages in and out (eps_hil/growing.py): `own memory` is
the rest, at its most. A log of a tenth of the size beside it: linear is a ratio of 1. Exit status
1 if either fails.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from batch_estimator import ROOT
from decode_log import DBC, SIGNALS, write

SECONDS = 120


def make(path: Path, size: float) -> int:
    """Write the log, ``size`` bytes or a little more; how many."""
    return _mf4(path, size) if path.suffix == ".mf4" else _candump(path, size)


def _mf4(path: Path, size: float) -> int:
    import asammdf

    once = path.with_suffix(".once.mf4")
    write(once, SECONDS)
    with asammdf.MDF(once, process_bus_logging=False) as short, asammdf.MDF() as long:
        frames = short.get("CAN_DataFrame", raw=True)
        long.header.abs_time = short.header.abs_time
        group = long.append(frames, acq_name="CAN", acq_source=frames.source)
        seconds, a_round = frames.timestamps, len(frames) * (8 + frames.samples.dtype.itemsize)
        for _ in range(int(size // a_round)):
            seconds = seconds + SECONDS
            long.extend(group, [(seconds, None), (frames.samples, None)])
        long.save(path, overwrite=True, compression=0)
    once.unlink()
    return path.stat().st_size


def _candump(path: Path, size: float) -> int:
    once = path.with_suffix(".once.log")
    write(once, SECONDS)
    text = np.frombuffer(once.read_bytes(), np.uint8).copy()
    once.unlink()
    ends = np.flatnonzero(text == ord("\n"))
    at = np.concatenate(([0], ends[:-1] + 1))[:, None] + 1 + np.arange(10)  # after "("
    place = 10 ** np.arange(9, -1, -1)
    seconds = ((text[at] - ord("0")).astype(np.int64) * place).sum(axis=1)
    written = 0
    with path.open("wb") as out:
        while written < size:
            text[at] = seconds[:, None] // place % 10 + ord("0")
            written += out.write(text.tobytes())
            seconds += SECONDS
    return written


def own_memory(process: int) -> int:
    """Bytes that no file stands behind; 0 where the process is gone."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(one.split()[1]) << 10 for one in lines if one.startswith("RssAnon")), 0)


def measured(folder: Path, size: float, suffix: str) -> float | None:
    """Seconds a gigabyte, said with the rest; None where it failed."""
    log = folder / f"long{suffix}"
    written = make(log, size)
    begun, most = time.perf_counter(), 0
    running = subprocess.Popen(
        [sys.executable, "-m", "eps_hil.cli", "estimate", str(log), "--dbc", str(DBC),
         "--signals", str(SIGNALS), "--model", str(ROOT / "configs/reference_rig.yaml"),
         "--out", str(folder / "long.parquet")],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    while running.poll() is None:
        most = max(most, own_memory(running.pid))
        time.sleep(0.05)
    took = time.perf_counter() - begun
    log.unlink()
    if running.returncode:
        print(f"{written / 1e9:5.2f} GB: ended with {running.returncode}")
        return None
    a_gb = took / (written / 1e9)
    print(f"{written / 1e9:5.2f} GB: {took:6.1f} s, {a_gb:5.1f} s a GB, own memory {most >> 20} MB")
    return a_gb


def main() -> int:
    """Both, and their ratio."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--gb", type=float, default=10.0)
    ask.add_argument("--suffix", choices=(".log", ".mf4"), default=".log")
    ask.add_argument("--folder", type=Path, default=Path("/var/tmp"))
    chosen = ask.parse_args()
    with tempfile.TemporaryDirectory(dir=chosen.folder) as folder:
        each = [
            measured(Path(folder), share * chosen.gb * 1e9, chosen.suffix) for share in (0.1, 1.0)
        ]
    if each[0] is None or each[1] is None:
        return 1
    print(f"ratio {each[1] / each[0]:.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
