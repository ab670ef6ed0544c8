#!/usr/bin/env python3
"""What an edit of one file with compiled code costs the next `estimate` and `diagnose`.

    python benchmarks/after_an_edit.py [--revision HEAD~1] [--edit diagnosis/balance/problem.py]

A copy of the package fills an empty cache of compiled functions. Then, for each verb: its first
answer with everything compiled (the better of two), and that after a comment was added at the end
of the edited file, which every cache must take for other code. ``--revision``: the same for the
package as it was there, in the same run. A recording of 30 s; whatever compiles in the background
is waited for at first and ended after an edit. Processor seconds (user and system) of the command
itself say what it costs on a busy machine, too.
"""

import argparse
import ctypes
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from batch_estimator import ROOT, recording

from eps_hil.physics.model import load_model
from eps_hil.recordings.write import write_table

MODEL = ROOT / "configs/reference_rig.yaml"
_ADOPT_ORPHANS = 36  # PR_SET_CHILD_SUBREAPER of prctl(2)


class Package:
    """A copy of the package with a cache of its own, and the recording."""

    def __init__(self, folder: Path, revision: str) -> None:
        self.folder, self.name = folder, revision or "here"
        folder.mkdir()
        if revision:
            packed = subprocess.run(
                ["git", "archive", revision, "eps_hil"], cwd=ROOT, check=True, capture_output=True
            )
            subprocess.run(["tar", "x"], cwd=folder, input=packed.stdout, check=True)
        else:
            shutil.copytree(
                ROOT / "eps_hil", folder / "eps_hil", ignore=shutil.ignore_patterns("__pycache__")
            )

    def run(self, verb: str, drive: Path, *, to_the_end: bool) -> tuple[float, float]:
        """A verb's answer: seconds by the clock, processor seconds."""
        words = {"estimate": [drive, "--out", "out.csv"], "diagnose": ["--recording", drive]}
        command = [sys.executable, "-m", "eps_hil.cli", verb, *words[verb], "--model", MODEL]
        environment = os.environ | {"XDG_CACHE_HOME": str(self.folder), "PYTHONPATH": "."}
        environment.pop("NUMBA_CACHE_DIR", None)
        before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(
            list(map(str, command)), check=True, stdout=subprocess.DEVNULL, cwd=self.folder,
            env=environment,
        )  # fmt: skip
        took = time.perf_counter() - begun
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        for orphan in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split():
            if not to_the_end:
                os.kill(int(orphan), signal.SIGKILL)
            os.waitpid(int(orphan), 0)
        return took, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    def measure(self, drive: Path, edited: str) -> None:
        """Fill the cache; then each verb before and after an edit."""
        for verb in ("estimate", "diagnose"):
            took, cpu = self.run(verb, drive, to_the_end=True)
            print(f"{self.name}: {verb}, nothing compiled {took:6.1f} s, {cpu:6.1f} processor s")
        source = self.folder / "eps_hil" / edited
        text = source.read_text(encoding="utf-8")
        for number, verb in enumerate(("estimate", "diagnose")):
            compiled = min(
                (self.run(verb, drive, to_the_end=True) for _ in range(2)), key=lambda one: one[1]
            )
            source.write_text(f"{text}# edit {number}\n", encoding="utf-8")
            after = self.run(verb, drive, to_the_end=False)
            source.write_text(text, encoding="utf-8")
            print(
                f"{self.name}: {verb}, all compiled {compiled[0]:6.1f} s, {compiled[1]:6.1f} "
                f"processor s; after an edit of {edited} {after[0]:6.1f} s, {after[1]:6.1f} "
                f"processor s: x {after[0] / compiled[0]:.1f}, processor x "
                f"{after[1] / compiled[1]:.1f}",
                flush=True,
            )


def main() -> None:
    """This package, and one of another revision."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--revision", help="measure that too, first")
    parser.add_argument("--edit", default="diagnosis/balance/problem.py", metavar="FILE")
    chosen = parser.parse_args()
    ctypes.CDLL(None).prctl(_ADOPT_ORPHANS, 1, 0, 0, 0)
    with tempfile.TemporaryDirectory() as name:
        series = recording(load_model(MODEL), 30.0)
        columns = {signal_: one.value for signal_, one in series.items()}
        drive = Path(name) / "drive.csv"
        write_table(drive, columns, t_ns=series["motor_speed_rad_s"].t_ns)
        for number, revision in enumerate(filter(None, [chosen.revision, "here"])):
            package = Package(Path(name) / str(number), "" if revision == "here" else revision)
            package.measure(drive, chosen.edit)


if __name__ == "__main__":
    main()
