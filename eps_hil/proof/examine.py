"""Have every case diagnosed by a process of its own, which is handed recordings and model only.

    python -m eps_hil.proof.examine OUT_DIR RESULTS_DIR [--jobs 2]

runs ``eps-hil diagnose`` on a copy of each case in a temporary folder, so that no path leads from
there to the answers. Cases that have a result are left alone: an examination that was
interrupted goes on where it stopped.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

MODEL = "model.yaml"
_TIMEOUT_S = 600.0


def diagnose(case: Path, result: Path) -> str:
    """Diagnose one case folder into a JSON file; returns what went wrong, or nothing."""
    with tempfile.TemporaryDirectory() as folder:
        desk = Path(folder)
        for path in case.iterdir():
            shutil.copy(path, desk / path.name)
        command = [sys.executable, "-m", "eps_hil.cli", "diagnose", "--json", "diagnosis.json"]
        command += arguments(sorted(path.name for path in case.iterdir()))
        try:
            ended = subprocess.run(
                command, cwd=desk, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
            )
        except subprocess.TimeoutExpired:
            return f"no diagnosis within {_TIMEOUT_S:.0f} s"
        if ended.returncode != 0:
            said = ended.stderr.strip().splitlines()
            return f"exit status {ended.returncode}: {said[-1] if said else ''}"
        shutil.move(desk / "diagnosis.json", result)
    return ""


def arguments(names: Sequence[str]) -> list[str]:
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
    return given


def open_cases(out: Path, results: Path) -> list[Path]:
    """Case folders that have no result yet, in the order of their (meaningless) names."""
    folders = sorted(path.parent for path in out.glob(f"*/{MODEL}"))
    return [folder for folder in folders if not (results / f"{folder.name}.json").exists()]


def examine(out: Path, results: Path, jobs: int = 1) -> Iterator[tuple[str, str]]:
    """Diagnose all open cases, ``jobs`` at once; yields (id, what went wrong or nothing)."""
    results.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(jobs) as pool:
        running = {
            pool.submit(diagnose, case, results / f"{case.name}.json"): case.name
            for case in open_cases(out, results)
        }
        for done in as_completed(running):
            yield running[done], done.result()


def main(given: Sequence[str] | None = None) -> int:
    """The command line; 1 where a case could not be diagnosed."""
    parser = argparse.ArgumentParser(prog="python -m eps_hil.proof.examine", description=__doc__)
    parser.add_argument("out", type=Path, help="folder of the cases")
    parser.add_argument("results", type=Path, help="folder for the diagnoses, <id>.json")
    parser.add_argument("--jobs", type=int, default=1)
    chosen = parser.parse_args(given)
    bad = 0
    for count, (id, problem) in enumerate(examine(chosen.out, chosen.results, chosen.jobs), 1):
        if problem:
            bad += 1
            sys.stderr.write(f"{id}: {problem}\n")
        elif sys.stderr.isatty():
            sys.stderr.write(f"\r{count} diagnosed")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main())
