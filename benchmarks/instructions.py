#!/usr/bin/env python3
"""Instructions of the batch estimator beside those of the same estimator by hand in C.

    python benchmarks/instructions.py --limit 5.5

Counted by valgrind's callgrind, which reads no clock: the figure is the same on a busy machine. The
first run compiles for a plain processor (a minute), since valgrind does not know every new one;
both are counted on a recording that was run through before, so neither compiling nor loading is in
it. Exit status 1 if the ratio is above --limit. Needs valgrind (Debian: apt-get install valgrind).
"""

import argparse
import ctypes
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from batch_estimator import ROOT, peer, recording

PLAIN = {"NUMBA_CPU_NAME": "x86-64-v2", "NUMBA_CPU_FEATURES": "+sse4.2,+popcnt",
         "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}  # fmt: skip
"""What valgrind knows; and no threads that count while they wait."""
SHIM = """
#include <valgrind/callgrind.h>
void begin(void) { CALLGRIND_START_INSTRUMENTATION; CALLGRIND_ZERO_STATS; }
void end(void) { CALLGRIND_DUMP_STATS; CALLGRIND_STOP_INSTRUMENTATION; }
"""
SECONDS = 20.0


def library(folder: Path, name: str, source: Path) -> ctypes.CDLL:
    """C without what valgrind may not know, compiled."""
    out = folder / f"{name}.so"
    command = ["cc", "-O3", "-std=gnu11", "-shared", "-fPIC", "-o", str(out), str(source), "-lm"]
    subprocess.run(command, check=True)
    return ctypes.CDLL(str(out))


def counted(folder: Path) -> None:
    """Under valgrind: each once to get ready, then between the marks."""
    from eps_hil.estimation.batch import estimate
    from eps_hil.physics.model import load_model

    model = load_model(ROOT / "configs/reference_rig.yaml")
    series = recording(model, SECONDS)
    (folder / "shim.c").write_text(SHIM, encoding="utf-8")
    marks = library(folder, "shim", folder / "shim.c")
    by_hand = library(folder, "peer", ROOT / "benchmarks/batch_estimator.c").estimate
    by_hand.restype = ctypes.c_long
    for call in (lambda: estimate(series, model), peer(by_hand, model, series)):
        call()
        marks.begin()
        call()
        marks.end()


def count(folder: Path) -> tuple[int, int]:
    """Instructions of ours and of the peer."""
    again = [sys.executable, __file__, "--counted", str(folder)]
    environment = os.environ | PLAIN
    subprocess.run(again, check=True, env=environment)  # compiles, without valgrind's patience
    valgrind = ["valgrind", "-q", "--tool=callgrind", "--instr-atstart=no",
                f"--callgrind-out-file={folder}/count"]  # fmt: skip
    subprocess.run([*valgrind, *again], check=True, env=environment)
    found = []
    for part in (1, 2):
        text = (folder / f"count.{part}").read_text(encoding="utf-8")
        told = re.search(r"^totals: (\d+)", text, re.MULTILINE)
        assert told is not None
        found.append(int(told[1]))
    return found[0], found[1]


def main() -> int:
    """Count both, say what came out."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--limit", type=float, default=float("inf"), help="exit 1 above this ratio")
    ask.add_argument("--counted", type=Path, help=argparse.SUPPRESS)
    chosen = ask.parse_args()
    if chosen.counted:
        counted(chosen.counted)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        ours, by_hand = count(Path(folder))
    steps = SECONDS * 1000.0
    print(f"{SECONDS:g} s at 1 kHz\neps_hil   {ours / steps:7.0f} instructions a step")
    print(f"C by hand {by_hand / steps:7.0f}\nratio {ours / by_hand:.2f}")
    return int(ours / by_hand > chosen.limit)


if __name__ == "__main__":
    sys.exit(main())
