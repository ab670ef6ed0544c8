"""Have every case diagnosed by a process of its own, which is handed recordings and model only.

    python -m eps_hil.proof.examine OUT_DIR RESULTS_DIR [--jobs 2]

runs ``eps-hil diagnose`` on a copy of each case in a temporary folder, so that no path leads from
there to the answers. Cases that have a result are left alone: an examination that was
interrupted goes on where it stopped.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

MODEL, WITHOUT = "model.yaml", "without.txt"
PROBLEM = ".problem.txt"
"""What went wrong with a case stands in ``<id>.problem.txt`` instead of ``<id>.json``."""
_TIMEOUT_S = 900.0
_HANDED_IN = {"diagnosis.json": ".json", "augmented.yaml": ".yaml", "report.html": ".html"}
_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}


@dataclass(frozen=True, slots=True)
class Examined:
    """One case: what went wrong, or nothing, and how long it took."""

    id: str
    problem: str
    seconds: float


def diagnose(case: Path, results: Path) -> Examined:
    """Diagnose one case folder; results/<id>.json, .yaml (the augmented model), .html."""
    since = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        desk = Path(folder)
        for path in case.iterdir():
            shutil.copy(path, desk / path.name)
        problem = _run(desk, arguments(sorted(path.name for path in case.iterdir()), case))
        for name, suffix in _HANDED_IN.items():
            if not problem and (desk / name).exists():
                shutil.move(desk / name, results / f"{case.name}{suffix}")
    if problem:
        (results / f"{case.name}{PROBLEM}").write_text(problem + "\n")
    return Examined(case.name, problem, time.monotonic() - since)


def _run(desk: Path, given: Sequence[str]) -> str:
    command = [sys.executable, "-m", "eps_hil.cli", "diagnose", "--json", "diagnosis.json"]
    command += ["--write-model", "augmented.yaml", "--report", "report.html", *given]
    try:
        ended = subprocess.run(
            command,
            cwd=desk,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
            env={**os.environ, **_ONE_THREAD},
        )
    except subprocess.TimeoutExpired:
        return f"no diagnosis within {_TIMEOUT_S:.0f} s"
    if ended.returncode != 0:
        said = ended.stderr.strip().splitlines()
        return f"exit status {ended.returncode}: {said[-1] if said else ''}"
    return ""


def arguments(names: Sequence[str], case: Path | None = None) -> list[str]:
    """Command-line arguments for the files of a case folder, CSV or CAN logs."""
    given = ["--model", MODEL]
    for name in names:
        if name.startswith("train_"):
            given += ["--recording", name]
        elif name.startswith("holdout"):
            given += ["--holdout", name]
        elif name.endswith(".dbc"):
            given += ["--dbc", name, "--gaps", "mark"]
        elif name == "signals.yaml":
            given += ["--signals", name]
        elif name == WITHOUT and case is not None:
            for effect in (case / name).read_text().split():
                given += ["--without-effect", effect]
    return given


def open_cases(out: Path, results: Path) -> list[Path]:
    """Case folders that have no result yet, in the order of their (meaningless) names."""
    folders = sorted(path.parent for path in out.glob(f"*/{MODEL}"))
    return [f for f in folders if not (_handed_in(results, f.name) or _failed(results, f.name))]


def _handed_in(results: Path, id: str) -> bool:
    return (results / f"{id}.json").exists()


def _failed(results: Path, id: str) -> bool:
    return (results / f"{id}{PROBLEM}").exists()


def examine(out: Path, results: Path, jobs: int = 1) -> Iterator[Examined]:
    """Diagnose all open cases, ``jobs`` at once; yields each as it is done."""
    results.mkdir(parents=True, exist_ok=True)
    pool = ThreadPoolExecutor(jobs)
    try:
        running = [pool.submit(diagnose, case, results) for case in open_cases(out, results)]
        for done in as_completed(running):
            yield done.result()
    finally:  # an interruption does not wait for what has not begun
        pool.shutdown(cancel_futures=True)


def main(given: Sequence[str] | None = None) -> int:
    """The command line; 1 where a case could not be diagnosed."""
    parser = argparse.ArgumentParser(prog="python -m eps_hil.proof.examine", description=__doc__)
    parser.add_argument("out", type=Path, help="folder of the cases")
    parser.add_argument("results", type=Path, help="folder for the diagnoses, <id>.json")
    parser.add_argument("--jobs", type=int, default=1)
    chosen = parser.parse_args(given)
    bad = 0
    for count, one in enumerate(examine(chosen.out, chosen.results, chosen.jobs), 1):
        if one.problem:
            bad += 1
            sys.stderr.write(f"{one.id}: {one.problem}\n")
        elif sys.stderr.isatty():
            sys.stderr.write(f"\r{count} diagnosed")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main())
