"""Two states of one rig: what differs is hidden, sealed, asked for by a stranger, and judged.

Half of the cases have a change, an effect at :data:`LEVEL` of the sensor noise that is new or gone;
half have none. In every second case of both halves both states share an effect that no catalogue
holds, at :data:`SHARED` of the noise, which does not change. The folder:

    changes.json             what was asked for
    cases/ID/                before_1..3.csv, after_1..3.csv, model.yaml
    answers.json, .sha256    the sealed answers, and their hash as it was printed
    results/ID.json          what ``eps-hil changes`` said
"""

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.errors import InputError
from eps_hil.proof.effects import ALIENS, CATALOGUED, find
from eps_hil.proof.examine import MODEL, PROBLEM, Diagnoser
from eps_hil.proof.model_file import model_yaml
from eps_hil.proof.plans import PROOF_SEEDS, lasting, near
from eps_hil.proof.score import Share
from eps_hil.proof.seal import opaque_id, open_answers, seal
from eps_hil.proof.states import State, two_states
from eps_hil.proof.truth import Drive
from eps_hil.proof.write import write_csv

LEVEL, SHARED = 0.6, 3.0
"""Effect-to-noise ratios of the change, and of what both states share."""
SCHEMA = "eps-hil/proof-changes/1"
_KIND = 24

Say = Callable[[str], None]
Part = Callable[[float], None]
Ask = Callable[[Sequence[str], Path, Path], object]
"""(arguments of eps-hil, case folder, folder of results): as :meth:`Diagnoser.ask`."""


@dataclass(frozen=True, slots=True)
class ChangePlan:
    """One case; ``change`` and ``shared`` are empty where there is none."""

    seed: int
    change: str = ""
    gone: bool = False
    shared: str = ""


def change_plans(seed: int, count: int, *, proof: bool) -> list[ChangePlan]:
    """``count`` plans: with and without a change, alone and beside something, new and gone."""
    first = seed * 1000 + (PROOF_SEEDS if proof else 0)
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


def prove_changes(
    out: Path,
    seed: int,
    count: int,
    *,
    proof: bool = True,
    say: Say = lambda _line: None,
    part: Part = lambda _part: None,
    ask: Ask | None = None,
) -> dict[str, Any]:
    """Run a proof in ``out``, or go on with it; the result is JSON-ready."""
    asked = {"schema": SCHEMA, "seed": seed, "cases": count, "proof": proof}
    _begin(out, asked)
    results, answers = out / "results", out / "answers.json"
    results.mkdir(exist_ok=True)
    if not answers.exists():
        shutil.rmtree(out / "cases", ignore_errors=True)  # of a run that was ended before its seal
        planned = {opaque_id(): plan for plan in change_plans(seed, count, proof=proof)}
        made = {}
        for id, plan in planned.items():
            made[id] = hide(plan, out / "cases" / id)
            part(0.2 * len(made) / count)
        say(f"{count} cases hidden, answers sealed: sha256 {seal(answers, made)}")
    if ask is None:
        with Diagnoser() as diagnoser:
            _ask(out, diagnoser.ask, part)
    else:
        _ask(out, ask, part)
    return {**asked, **_judged(open_answers(answers), results, say)}


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


def _ask(out: Path, ask: Ask, part: Part) -> None:
    """Every case that has no answer yet."""
    results, cases = out / "results", sorted((out / "cases").iterdir())
    for number, case in enumerate(cases, 1):
        there = [results / f"{case.name}{suffix}" for suffix in (".json", PROBLEM)]
        if not any(path.exists() for path in there):
            ask(words_for(case), case, results)
        part(0.2 + 0.8 * number / len(cases))


def _judged(answers: Mapping[str, Any], results: Path, say: Say) -> dict[str, Any]:
    lines = []
    for id, answer in sorted(answers.items(), key=lambda one: int(one[1]["seed"])):
        path = results / f"{id}.json"
        content = json.loads(path.read_text()) if path.exists() else None
        judged = judge_change(answer, content)
        told = [] if content is None else [_told(one) for one in content["findings"]]
        said = ", ".join(told) or ("no answer" if content is None else "nothing")
        hidden = f"{answer['change']} {'gone' if answer['gone'] else 'new'}"
        hidden = hidden if answer["change"] else "nothing"
        beside = f" beside {answer['shared']}" if answer["shared"] else ""
        say(f"{'right' if judged.right else 'WRONG'}  {hidden}{beside} -> {said}")
        lines.append({"answer": answer, "told": told, **asdict(judged)})
    figures = {}
    for key, some in (
        ("with_change", [one for one in lines if one["answer"]["change"]]),
        ("without_change", [one for one in lines if not one["answer"]["change"]]),
    ):
        for what, hits in (
            ("right", sum(one["right"] for one in some)),
            ("false_name", sum(bool(one["false"]) for one in some)),
        ):
            share = Share(f"{key}, {what}".replace("_", " "), hits, len(some))
            say(str(share))
            figures[f"{key}_{what}"] = {"hits": hits, "cases": len(some), "ci95": share.interval}
    return {"figures": figures, "lines": lines}


def _told(finding: Mapping[str, Any]) -> str:
    return f"{finding['effect']} {finding.get('change', {}).get('is', '')}".strip()
