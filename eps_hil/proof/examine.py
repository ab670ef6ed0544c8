"""Have every case diagnosed by a process of its own, which is handed recordings and model only.

    python -m eps_hil.proof.examine OUT_DIR RESULTS_DIR [--jobs 2]

runs ``eps-hil diagnose`` on a copy of each case in a temporary folder, so that no path leads from
there to the answers. Processes that have only loaded the code (``eps_hil/cli/_warm.py``) fork
themselves for each case. Cases that have a result are left alone: an examination that was
interrupted goes on where it stopped.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType

from eps_hil.errors import EpsHilError

MODEL, WITHOUT = "model.yaml", "without.txt"
PROBLEM = ".problem.txt"
"""What went wrong with a case stands in ``<id>.problem.txt`` instead of ``<id>.json``."""
_TIMEOUT_S = 900.0
"""Of processor time."""
_ASKED_FOR = ("--json", "diagnosis.json", "--write-model", "augmented.yaml")
_PAGE = ("--report", "report.html")
_HANDED_IN = {"diagnosis.json": ".json", "augmented.yaml": ".yaml", "report.html": ".html"}
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
"""Environment that keeps linear algebra on one core."""


@dataclass(frozen=True, slots=True)
class Examined:
    """One case: what went wrong, or nothing, and how long it took."""

    id: str
    problem: str
    seconds: float


class Diagnoser:
    """A process that diagnoses one case after the other, each in a fork of its own."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "eps_hil.cli._warm"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **ONE_THREAD},
        )

    def __enter__(self) -> "Diagnoser":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: object, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.communicate()

    def diagnose(self, case: Path, results: Path, *, page: bool = True) -> Examined:
        """Diagnose one case folder; results/<id>.json, .yaml (the augmented model), .html."""
        return self.ask(_words(case, page=page), case, results)

    def ask(self, words: Sequence[str], case: Path, results: Path) -> Examined:
        """Have a verb answer in a copy of the case folder; what it hands in goes to results."""
        since = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            desk = Path(folder)
            for path in case.iterdir():
                shutil.copy(path, desk / path.name)
            problem = self._run(desk, words)
            for name, suffix in _HANDED_IN.items():
                if not problem and (desk / name).exists():
                    shutil.move(desk / name, results / f"{case.name}{suffix}")
        if problem:
            (results / f"{case.name}{PROBLEM}").write_text(problem + "\n")
        return Examined(case.name, problem, time.monotonic() - since)

    def _run(self, desk: Path, given: Sequence[str]) -> str:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([str(desk), _TIMEOUT_S, given]) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise EpsHilError("the process that diagnoses ended by itself")
        status = json.loads(answer)
        if status is None:
            return f"no answer within {_TIMEOUT_S:.0f} s of processor time"
        if status != 0:
            said = (desk / "stderr.txt").read_text().strip().splitlines()
            return f"exit status {status}: {said[-1] if said else ''}"
        return ""


def _words(case: Path, *, page: bool = True) -> Sequence[str]:
    given = arguments(sorted(path.name for path in case.iterdir()), case)
    return ["diagnose", *_ASKED_FOR, *(_PAGE if page else ()), *given]


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


def examine(
    out: Path,
    results: Path,
    jobs: int = 1,
    words: Callable[[Path], Sequence[str]] | None = None,
) -> Iterator[Examined]:
    """Diagnose all open cases, ``jobs`` at once; yields each as it is done.

    ``words``: arguments of ``eps-hil`` for a case folder, where that is not ``diagnose``.
    """
    with Diagnosers(jobs) as diagnosers:
        for done in as_completed(diagnosers.ask(open_cases(out, results), results, words)):
            yield done.result()


class Diagnosers:
    """So many processes that diagnose at once, asked for cases in the order of the asking.

    One batch may be asked for while the last cases of another are still in work.
    """

    def __init__(self, jobs: int) -> None:
        self._pool = ThreadPoolExecutor(jobs)
        self._all = [Diagnoser() for _ in range(jobs)]
        self._idle: SimpleQueue[Diagnoser] = SimpleQueue()
        for one in self._all:
            self._idle.put(one)

    def __enter__(self) -> "Diagnosers":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: object, trace: TracebackType | None
    ) -> None:
        self.close()

    def ask(
        self,
        cases: Sequence[Path],
        results: Path,
        words: Callable[[Path], Sequence[str]] | None = None,
    ) -> list[Future[Examined]]:
        """One answer to come for each case folder; ``words`` as in :func:`examine`."""
        results.mkdir(parents=True, exist_ok=True)
        return [self._pool.submit(self._ask_one, case, results, words) for case in cases]

    def close(self) -> None:
        """End the processes; an interruption does not wait for what has not begun."""
        for one in self._all:
            one.close()
        self._pool.shutdown(cancel_futures=True)

    def _ask_one(
        self, case: Path, results: Path, words: Callable[[Path], Sequence[str]] | None
    ) -> Examined:
        one = self._idle.get()
        try:
            return one.ask(words(case) if words else _words(case), case, results)
        finally:
            self._idle.put(one)


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
