"""A whole proof, batch by batch: hide, seal, have it diagnosed, open, measure, note down.

A batch is sealed, and its hash published, before anything in it is diagnosed. Whatever was
interrupted goes on where it stopped: finished batches are not touched, a batch that was sealed is
diagnosed further, one that was not is made anew. The folder:

    run.json                what was asked for
    seals.txt               batch, hash of its answers: as they were printed
    batch_001/cases/        recordings and model file under opaque ids
    batch_001/answers.json  the sealed answers        batch_001/truth/   true rack forces
    batch_001/results/      what the diagnosis handed in
    batch_001/lines.jsonl   the batch's cases, opened and measured
    cases.jsonl             all of these lines        reports/   the pages of the diagnoses
"""

import hashlib
import json
import math
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.errors import InputError
from eps_hil.proof.cases import make
from eps_hil.proof.code_version import code_version
from eps_hil.proof.examine import MODEL, ONE_THREAD, PROBLEM, Diagnosers, Examined, open_cases
from eps_hil.proof.judge import Judgement, failed, judge
from eps_hil.proof.long_case import seconds_to_diagnose
from eps_hil.proof.plans import MIX, QUICK, Plan, mixed
from eps_hil.proof.seal import opaque_id, open_answers, seal
from eps_hil.proof.truth import Floats
from eps_hil.proof.write import write_can_case, write_case

BATCH = 28
LINES, SEALS, REPORTS = "cases.jsonl", "seals.txt", "reports"
LONG, LEAST_FOR_LONG = "twenty_minutes.json", 100
Asked = Sequence[Future[Examined]]
"""Answers to come."""
Worths = dict[str, dict[str, float | None]]
Measure = Callable[[Path, Floats, Mapping[str, Path]], Worths]
"""(case folder, true rack force, model files by name) -> figures by model."""
Say = Callable[[str], None]
Part = Callable[[float], None]


def strangers(jobs: int) -> Executor:
    """Processes that are spawned, and so know nothing but what they are handed.

    Each works on one core: with as many workers as cores, more threads only wait for each other.
    """
    os.environ.update(ONE_THREAD)
    return ProcessPoolExecutor(
        jobs, get_context("spawn"), initializer=_end_with, initargs=(os.getpid(),)
    )


def _end_with(parent: int) -> None:
    """A worker ends when whoever started it is gone, killed or not."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@dataclass(frozen=True, slots=True)
class Setting:
    """What a run was asked for; a run goes on only with the same."""

    seed: int
    quick: bool
    proof: bool
    cases: int
    kinds: tuple[str, ...] = ()
    """Of ``plans.MIX``; empty for all."""

    def plans(self) -> list[Plan]:
        """The plans, in the order in which they are examined."""
        whole = QUICK if self.quick else MIX
        mix = {kind: whole[kind] for kind in self.kinds or whole}
        return mixed(mix, self.seed, proof=self.proof)[: self.cases]

    def said(self) -> dict[str, Any]:
        """As its file holds it."""
        return {**asdict(self), "kinds": list(self.kinds)}


@dataclass(frozen=True, slots=True)
class Desk:
    """How a run works: its workers, whether recordings are kept, and who is told."""

    measure: Measure
    jobs: int = 1
    workers: Callable[[int], Executor] = strangers
    time_long: Callable[[int], float | None] = seconds_to_diagnose
    keep: bool = False
    say: Say = lambda _line: None
    part: Part = lambda _part: None


def run(out: Path, setting: Setting, desk: Desk, *, resume: bool = False) -> list[dict[str, Any]]:
    """Run or finish a proof in ``out``; returns the lines of all cases."""
    _begin(out, setting, resume)
    plans = setting.plans()
    batches = [plans[k : k + BATCH] for k in range(0, len(plans), BATCH)]
    with desk.workers(desk.jobs) as pool, Diagnosers(desk.jobs) as diagnosers:
        every = [
            _Batch(out, number, len(batches), batch, desk, pool)
            for number, batch in enumerate(batches, 1)
        ]
        for batch, asked in _asked_ahead(_hidden_ahead(every), diagnosers):
            if not batch.done:
                batch.finish(asked)
            _gather(out, batch.number)
            desk.part(batch.number / len(batches))
    if len(plans) >= LEAST_FOR_LONG and not setting.kinds and not (out / LONG).exists():
        taken = desk.time_long(setting.seed)
        (out / LONG).write_text(json.dumps({"seconds": taken}) + "\n")
    return read_lines(out)


def _asked_ahead(
    batches: Iterator["_Batch"], diagnosers: Diagnosers
) -> Iterator[tuple["_Batch", Asked]]:
    """The batches in turn with what was asked, each while the next is asked for already.

    A batch's last case may take minutes alone; no core has to wait for it.
    """
    coming: tuple[_Batch, Asked] | None = None
    for batch in batches:
        asked = [] if batch.done else batch.ask(diagnosers)
        if coming is not None:
            yield coming
        coming = batch, asked
    if coming is not None:
        yield coming


def _hidden_ahead(batches: Sequence["_Batch"]) -> Iterator["_Batch"]:
    """The batches in turn, each hidden and sealed while the one before is being diagnosed."""
    with ThreadPoolExecutor(1) as ahead:
        coming = ahead.submit(batches[0].hide) if batches else None
        try:
            for number, batch in enumerate(batches, 1):
                if coming is not None:
                    coming.result()
                coming = ahead.submit(batches[number].hide) if number < len(batches) else None
                yield batch
        finally:  # an interruption does not wait for what has not begun
            ahead.shutdown(wait=False, cancel_futures=True)


def read_lines(out: Path) -> list[dict[str, Any]]:
    """The cases that a run has finished so far."""
    path = out / LINES
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def long_seconds(out: Path) -> float | None:
    """What 20 minutes of recordings took; None where it was not tried, infinite where it failed."""
    told = _json(out / LONG)
    if not told:
        return None
    return math.inf if told["seconds"] is None else float(told["seconds"])


def judgement(line: Mapping[str, Any]) -> Judgement:
    """One line of ``cases.jsonl`` judged."""
    return judge(line["id"], line["answer"], line["diagnosis"])


def _begin(out: Path, setting: Setting, resume: bool) -> None:
    path = out / "run.json"
    if path.exists():
        if not resume:
            raise InputError(out, "--out", "holds a proof already", "add --resume, or name another")
        try:
            before = _json(path)
        except ValueError:
            raise InputError(path, "", "is damaged", "name another folder") from None
        if before != setting.said():
            raise InputError(out, "--resume", "was begun with other options", "name another folder")
    elif resume:
        raise InputError(
            out, "--resume", "there is no proof to go on with", "leave it out to begin"
        )
    elif out.is_dir() and any(out.iterdir()):
        raise InputError(out, "--out", "is not empty", "name a folder that is new")
    try:
        (out / REPORTS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"cannot be made: {error.strerror}"
        raise InputError(out, "--out", problem, "choose another folder") from None
    path.write_text(json.dumps(setting.said(), indent=1) + "\n")


def _folder(out: Path, number: int) -> Path:
    return out / f"batch_{number:03d}"


def _gather(out: Path, number: int) -> None:
    """``cases.jsonl`` anew up to this batch: whole lines of whole batches only."""
    parts = [(_folder(out, k) / "lines.jsonl").read_text() for k in range(1, number + 1)]
    temporary = out / f".{LINES}"
    temporary.write_text("".join(parts))
    temporary.replace(out / LINES)


@dataclass(frozen=True)
class _Batch:
    out: Path
    number: int
    batches: int
    plans: Sequence[Plan]
    desk: Desk
    pool: Executor

    @property
    def folder(self) -> Path:
        return _folder(self.out, self.number)

    @property
    def done(self) -> bool:
        """Whether every case is noted down."""
        return (self.folder / "lines.jsonl").exists()

    def hide(self) -> None:
        """Make the cases, seal their answers, publish the hash; unless that is done."""
        if not self.done and self._published() is None:
            self._hide()

    def ask(self, diagnosers: Diagnosers) -> Asked:
        """Have a batch that is hidden diagnosed: its cases that have no result yet."""
        results = self.folder / "results"
        return diagnosers.ask(open_cases(self.folder / "cases", results), results)

    def finish(self, asked: Asked) -> None:
        """Wait for the answers, open the seal, judge."""
        examined = {}
        for done in as_completed(asked):
            one = done.result()
            examined[one.id] = one
            self._progress(0.95 * len(examined) / len(self.plans))
        self._open(self._published() or "", examined)

    def _say(self, words: str) -> None:
        self.desk.say(f"batch {self.number}/{self.batches}: {words}")

    def _progress(self, share: float) -> None:
        self.desk.part((self.number - 1 + share) / self.batches)

    def _published(self) -> str | None:
        seals = self.out / SEALS
        known = (
            dict(line.split() for line in seals.read_text().splitlines()) if seals.exists() else {}
        )
        return known.get(str(self.number))

    def _hide(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        (self.folder / "truth").mkdir(parents=True)
        making = [self.pool.submit(hide, plan, self.folder, opaque_id()) for plan in self.plans]
        answers = {}
        for done in as_completed(making):
            id, answer = done.result()
            answers[id] = answer
        value = seal(self.folder / "answers.json", answers)
        with (self.out / SEALS).open("a") as file:
            file.write(f"{self.number} {value}\n")
        self._say(f"{len(answers)} cases hidden, answers sealed: sha256 {value}")

    def _open(self, published: str, examined: Mapping[str, Examined]) -> None:
        """The seal is opened: measure each case and note it down."""
        answers = open_answers(self.folder / "answers.json", published)
        measuring = {
            self.pool.submit(measured, self.folder, id, answer, self.desk.measure): id
            for id, answer in answers.items()
        }
        worths = {measuring[done]: done.result() for done in as_completed(measuring)}
        lines, wrong = [], 0
        for id, answer in sorted(answers.items()):
            line = self._line(id, answer, worths[id], examined.get(id))
            wrong += bool(line["failed"])
            lines.append(json.dumps(line, allow_nan=False))
        temporary = self.folder / ".lines.jsonl"
        temporary.write_text("\n".join(lines) + "\n")
        temporary.replace(self.folder / "lines.jsonl")
        if not self.desk.keep:
            for name in ("cases", "results", "truth"):
                shutil.rmtree(self.folder / name, ignore_errors=True)
        self._say(f"seal opened, {len(lines) - wrong} of {len(lines)} cases as they should be")

    def _wrong(self, id: str, answer: Mapping[str, Any]) -> bool:
        results = self.folder / "results"
        diagnosis = _json(results / f"{id}.json")
        return failed(judge(id, answer, diagnosis)) or (results / f"{id}{PROBLEM}").exists()

    def _line(
        self, id: str, answer: dict[str, Any], worths: Worths, examined: Examined | None
    ) -> dict[str, Any]:
        results = self.folder / "results"
        diagnosis = _json(results / f"{id}.json")
        problem = results / f"{id}{PROBLEM}"
        wrong = self._wrong(id, answer)
        page = results / f"{id}.html"
        report = ""
        if page.exists() and (wrong or self.desk.keep):
            report = f"{REPORTS}/{id}.html"
            shutil.move(page, self.out / report)
        return {
            "id": id,
            "batch": self.number,
            "failed": wrong,
            "report": report,
            "code": code_version(),
            "seconds": round(examined.seconds, 2) if examined else None,
            "problem": problem.read_text().strip() if problem.exists() else "",
            "worth": worths,
            "diagnosis": diagnosis,
            "answer": answer,
        }


def hide(plan: Plan, folder: Path, id: str) -> tuple[str, dict[str, Any]]:
    """Make one case and write it; its answer also holds the true model and the force's hash."""
    since = time.monotonic()
    case = make(plan)
    (write_can_case if plan.can else write_case)(folder / "cases" / id, case)
    np.save(folder / "truth" / f"{id}.npy", case.force_n)
    seconds = round(time.monotonic() - since, 2)
    sealed = {"oracle": case.oracle, "force_sha256": _digest(case.force_n), "seconds": seconds}
    return id, {**case.answer, **sealed}


def measured(folder: Path, id: str, answer: Mapping[str, Any], measure: Measure) -> Worths:
    """What nominal, augmented and true model are worth on the hold-out of one case."""
    force_n = np.load(folder / "truth" / f"{id}.npy")
    if _digest(force_n) != answer["force_sha256"]:
        raise InputError(folder / "truth" / f"{id}.npy", "", "is not the force that was sealed")
    case, augmented = folder / "cases" / id, folder / "results" / f"{id}.yaml"
    models = {"baseline": case / MODEL}
    if augmented.exists():
        models["augmented"] = augmented
    if answer["oracle"]:
        models["oracle"] = folder / "truth" / f"{id}.yaml"
        models["oracle"].write_text(answer["oracle"])
    try:
        worths = measure(case, force_n, models)
    except InputError as error:  # a model that cannot be read gains nothing, and is a failure
        if "augmented" not in models:
            raise
        problem = folder / "results" / f"{id}{PROBLEM}"
        problem.write_text(f"the model that it wrote: {error}\n")
        del models["augmented"]
        worths = measure(case, force_n, models)
        worths["augmented"] = worths["baseline"]
    return {
        model: {name: v if v is not None and math.isfinite(v) else None for name, v in one.items()}
        for model, one in worths.items()
    }


def _digest(values: Floats) -> str:
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()


def _json(path: Path) -> dict[str, Any] | None:
    return dict(json.loads(path.read_text())) if path.exists() else None
