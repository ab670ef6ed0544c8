"""Two states of one rig: what differs is hidden, sealed, asked for by a stranger, and judged.

Half of the cases have a change, an effect at :data:`LEVEL` of the sensor noise that is new or gone;
half have none. In every second case of both halves both states share an effect that no catalogue
holds, at :data:`SHARED` of the noise, which does not change. A batch holds each mixture once; it is
sealed, and its hash said, before anything in it is asked. The folder:

    changes.json                        what was asked for
    batch_001/cases/ID/                 before_1..3.csv, after_1..3.csv, model.yaml (kept if wrong)
    batch_001/answers.json, .sha256     the sealed answers, and their hash as it was printed
    batch_001/results/ID.json           what ``eps-hil changes`` said
    batch_001/lines.jsonl               the batch's cases, opened and judged
    figures.json                        of all batches that are done
"""

import json
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.errors import InputError
from eps_hil.proof.code_version import code_version
from eps_hil.proof.effects import ALIENS, CATALOGUED, find
from eps_hil.proof.examine import MODEL, Examined, examine
from eps_hil.proof.model_file import model_yaml
from eps_hil.proof.plans import first_seed, lasting, near
from eps_hil.proof.run import strangers
from eps_hil.proof.score import Share
from eps_hil.proof.seal import opaque_id, open_answers, seal
from eps_hil.proof.states import State, two_states
from eps_hil.proof.truth import Drive
from eps_hil.proof.write import write_csv

LEVEL, SHARED = 0.6, 3.0
"""Effect-to-noise ratios of the change, and of what both states share."""
SCHEMA = "eps-hil/proof-changes/2"
BATCH = 8
LINES, FIGURES = "lines.jsonl", "figures.json"
_KIND = 24

Say = Callable[[str], None]
Part = Callable[[float], None]
Ask = Callable[[Path, Path, int], Iterable[Examined]]
"""(folder of cases, folder of results, jobs): asks every case that has no result yet."""


@dataclass(frozen=True, slots=True)
class ChangePlan:
    """One case; ``change`` and ``shared`` are empty where there is none."""

    seed: int
    change: str = ""
    gone: bool = False
    shared: str = ""


def change_plans(seed: int, count: int, *, proof: bool) -> list[ChangePlan]:
    """``count`` plans: with and without a change, alone and beside something, new and gone."""
    first = first_seed(seed, proof=proof)
    rng = np.random.default_rng([first, _KIND])
    planned = []
    for k in range(count):
        shared = str(rng.choice(list(ALIENS))) if k % 4 >= 2 else ""
        beside = {shared, *find(shared).twins} if shared else set()
        change = str(rng.choice([one for one in lasting() if one not in beside]))
        planned.append(ChangePlan(first + k, "" if k % 2 else change, k % 8 >= 4, shared))
    return planned


def hide(plan: ChangePlan, folder: Path) -> dict[str, Any]:
    """Write one case; what is returned is its answer."""
    shared = [(plan.shared, SHARED)] if plan.shared else []
    made = two_states(plan.seed, shared, (plan.change, LEVEL) if plan.change else None)
    states = (made.without, made.with_change)
    folder.mkdir(parents=True)
    (folder / MODEL).write_text(model_yaml(Drive()))
    for word, state in zip(("before", "after"), states[::-1] if plan.gone else states, strict=True):
        _write(folder, word, state)
    return {**asdict(plan), "ratio": made.reached}


def _write(folder: Path, word: str, state: State) -> None:
    for k, columns in enumerate(state.values(), 1):
        write_csv(folder / f"{word}_{k}.csv", columns)


def words_for(case: Path) -> list[str]:
    """Arguments of ``eps-hil`` for a case folder."""
    words = ["changes", "--json", "diagnosis.json", "--model", MODEL]
    for option in ("before", "after"):
        words += [f"--{option}", *sorted(path.name for path in case.glob(f"{option}_*.csv"))]
    return words


@dataclass(frozen=True, slots=True)
class ChangeJudgement:
    """One case: as it should be, and names of the catalogue that are not what changed."""

    right: bool
    false: tuple[str, ...]


def judge_change(answer: Mapping[str, Any], content: Mapping[str, Any] | None) -> ChangeJudgement:
    """Right: the change is named (or what recordings may not tell from it) and nothing else is.

    Without a change right is to find none, and an ``unknown`` is wrong too.
    """
    if content is None:
        return ChangeJudgement(False, ())
    found = [one["effect"] for one in content["findings"]]
    allowed = near(answer["change"]) if answer["change"] else set()
    false = tuple(one for one in found if one not in allowed and one in CATALOGUED)
    hit = bool(allowed & set(found)) if answer["change"] else not found
    return ChangeJudgement(hit and not false, false)


def ask_all(cases: Path, results: Path, jobs: int) -> Iterable[Examined]:
    """``eps-hil changes`` of every case that has no result yet."""
    return examine(cases, results, jobs, words_for)


@dataclass(frozen=True)
class Desk:
    """How a proof works: its workers, who is asked, and who is told."""

    jobs: int = 1
    say: Say = lambda _line: None
    part: Part = lambda _part: None
    workers: Callable[[int], Executor] = strangers
    ask: Ask = ask_all


def prove_changes(
    out: Path, seed: int, count: int, desk: Desk, *, proof: bool = True
) -> dict[str, Any]:
    """Run a proof in ``out``, or go on with it; the result is JSON-ready."""
    asked = {"schema": SCHEMA, "seed": seed, "cases": count, "proof": proof}
    _begin(out, asked)
    plans = change_plans(seed, count, proof=proof)
    content: dict[str, Any] = {}
    lines: list[dict[str, Any]] = []
    with desk.workers(desk.jobs) as pool:
        for first in range(0, count, BATCH):
            folder = out / f"batch_{first // BATCH + 1:03d}"
            some = plans[first : first + BATCH]
            if not (folder / LINES).exists():
                _run(folder, some, desk, pool)
            text = (folder / LINES).read_text()
            lines += [json.loads(line) for line in text.splitlines()]
            content = {**asked, "figures": figures(lines), "lines": lines}
            _replaced(out / FIGURES, json.dumps(content, indent=1) + "\n")
            desk.part(len(lines) / count)
    for name, one in content["figures"].items():
        desk.say(str(Share(name.replace("_", " "), one["hits"], one["cases"])))
    return content


def _begin(out: Path, asked: Mapping[str, Any]) -> None:
    path = out / "changes.json"
    if path.exists():
        if json.loads(path.read_text()) != asked:
            raise InputError(out, "--out", "holds another proof", "name another folder")
        return
    if out.is_dir() and any(out.iterdir()):
        raise InputError(out, "--out", "is not empty", "name a folder that is new")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"cannot be made: {error.strerror}"
        raise InputError(out, "--out", problem, "name a folder that can be written") from None
    path.write_text(json.dumps(asked, indent=1) + "\n")


def _run(folder: Path, plans: Sequence[ChangePlan], desk: Desk, pool: Executor) -> None:
    """Hide and seal a batch, or go on with one that is sealed; ask, open, judge."""
    answers, cases, results = folder / "answers.json", folder / "cases", folder / "results"
    if not answers.exists():
        shutil.rmtree(folder, ignore_errors=True)  # of a run that was ended before its seal
        cases.mkdir(parents=True)
        making = {opaque_id(): plan for plan in plans}
        made = {id: pool.submit(hide, plan, cases / id) for id, plan in making.items()}
        value = seal(answers, {id: one.result() for id, one in made.items()})
        desk.say(f"{folder.name}: {len(made)} cases hidden, answers sealed: sha256 {value}")
    results.mkdir(exist_ok=True)
    seconds = {one.id: round(one.seconds, 1) for one in desk.ask(cases, results, desk.jobs)}
    lines = []
    for id, answer in sorted(open_answers(answers).items(), key=lambda one: int(one[1]["seed"])):
        path = results / f"{id}.json"
        content = json.loads(path.read_text()) if path.exists() else None
        judged = judge_change(answer, content)
        told = None if content is None else [_told(one) for one in content["findings"]]
        desk.say(f"{'right' if judged.right else 'WRONG'}  {_in_words(answer, told)}")
        known = {"id": id, "code": code_version(), "seconds": seconds.get(id)}
        lines.append({**known, "answer": answer, "told": told, **asdict(judged)})
    _replaced(folder / LINES, "".join(f"{json.dumps(line)}\n" for line in lines))
    for line in lines:
        if line["right"]:
            shutil.rmtree(cases / line["id"])


def _replaced(path: Path, text: str) -> None:
    """Written whole or not at all."""
    temporary = path.with_name(f".{path.name}")
    temporary.write_text(text)
    temporary.replace(path)


def figures(lines: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts of the judged cases, with and without a change, alone and beside what is shared.

    A change is right as :func:`judge_change` says; where there is none any finding is an alarm.
    """
    counted = {}
    for shared, where in ((None, ""), (False, "_alone"), (True, "_beside_shared")):
        some = [one for one in lines if shared in (None, bool(one["answer"]["shared"]))]
        changed = [one for one in some if one["answer"]["change"]]
        still = [one for one in some if not one["answer"]["change"]]
        for key, hits, of in (
            ("right_name", [one["right"] for one in changed], changed),
            ("wrong_name", [bool(one["false"]) for one in changed], changed),
            ("false_alarm", [bool(one["told"]) for one in still], still),
            ("no_answer", [one["told"] is None for one in some], some),
        ):
            share = Share(f"{key}{where}", sum(hits), len(of))
            counted[share.what] = {
                "hits": sum(hits),
                "cases": len(of),
                "ci95": list(share.interval),
            }
    return counted


def _in_words(answer: Mapping[str, Any], told: Sequence[str] | None) -> str:
    hidden = f"{answer['change']} {'gone' if answer['gone'] else 'new'}"
    hidden = hidden if answer["change"] else "nothing"
    beside = f" beside {answer['shared']}" if answer["shared"] else ""
    said = "no answer" if told is None else ", ".join(told) or "nothing"
    return f"{hidden}{beside} -> {said}"


def _told(finding: Mapping[str, Any]) -> str:
    return f"{finding['effect']} {finding.get('change', {}).get('is', '')}".strip()
