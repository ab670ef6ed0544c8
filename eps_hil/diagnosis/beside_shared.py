"""What differs between two states that share something without a name.

A diagnosis of one state against the other's model takes the faults of that model for changes. So
both states are fitted in one balance (``balance/both_states.py``), in which a name acts in one of
them only. Beside it, the same in both, are the laws that the known state's diagnosis found, their
numbers free in every fit, and a discrepancy for what those leave. A discrepancy can hold a change,
too: where no name stands beside one, one stands that explains more than laws and names leave.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.beside_law import outweighing
from eps_hil.diagnosis.accept.holdout_support import augmented_by, holdout_support
from eps_hil.diagnosis.accept.improvement import Judged, improvement, only_if_clear
from eps_hil.diagnosis.accept.measured_ratio import settled
from eps_hil.diagnosis.accept.placebo import as_lucky, placebos
from eps_hil.diagnosis.accept.standing import price, standing
from eps_hil.diagnosis.attribute.beside import LEAST, not_whitened, selected_beside
from eps_hil.diagnosis.attribute.select import Say, Selection, select
from eps_hil.diagnosis.balance.baseline import law_knobs
from eps_hil.diagnosis.balance.both_states import BothStates, ModelOfBoth, one_state
from eps_hil.diagnosis.balance.problem import Problem, clipped, huber, knee, plain, term_of
from eps_hil.diagnosis.balance.spread import half_widths
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.diagnosis.given_load import EMPIRICAL, Diagnosis
from eps_hil.diagnosis.one_way import MORE, OneWay, Share
from eps_hil.diagnosis.remainder.find import with_remainder
from eps_hil.diagnosis.search import left_of
from eps_hil.diagnosis.verdict.content import content_of, without_nan

Floats = npt.NDArray[np.float64]

_SHARED = (
    "Both states hold something without a name. It is fitted as one and the same in both; what "
    "stands here are differences between the states."
)
_LEFT = (
    "Both states keep a remainder above the sensors' noise, hardly more in one than in the other. "
    "It is not taken for a change; a diagnosis of one state says where it is."
)


@dataclass(frozen=True)
class BesideShared(OneWay):
    """As any direction; shares are told beside what both states have."""

    weighed: BothStates | None = None
    told_there: Selection | None = None

    def as_much_unknown(self) -> bool:
        """What both states have is none of the findings here."""
        return False

    def share(self, k: int) -> Share | None:
        """How much of finding ``k`` the known state has, beside all that both share."""
        entries, told, problem = self.entries(k), self.told_there, self.weighed
        if not entries or told is None or problem is None:
            return None
        found = told.found
        model = problem.with_entries(found.entries, found.own)
        assert isinstance(model, ModelOfBoth)
        assert model.known is not None
        more = tuple(dict(one) for one in entries)
        there = replace(model, known=replace(model.known, effects=(*model.known.effects, *more)))
        bare = tuple(one for one in model.effects if one not in more)
        columns = np.column_stack([
            problem.residual(there) - found.residual,
            found.residual - problem.residual(replace(model, effects=bare)),
        ])  # fmt: skip
        names = [i for i, (at, _) in enumerate(found.names) if plain(found.entries[at]) in more]
        others = np.delete(found.jacobian, [len(found.own) + i for i in names], axis=1)
        weight = np.sqrt(huber(found.residual, knee(found.residual)))[:, None]
        columns, others = columns * weight, others * weight
        left = found.residual * weight[:, 0]
        if float(np.sum(columns[:, 0] ** 2)) < 1.0:
            return Share(0.0, np.inf, 0.0)
        full = np.column_stack([columns, others])
        size = np.sqrt(np.sum(full**2, axis=0)) + 1e-300
        step = -np.linalg.lstsq(full / size, left, rcond=1e-9)[0] / size
        wide = half_widths(full, left + full @ step, (problem.block, problem.stretch))
        return Share(float(step[0]), float(wide[0]), float(wide[1]))


def alike(first: Diagnosis, second: Diagnosis) -> bool:
    """Whether both states can be fitted in one balance: their recordings were put right alike."""
    return first.problem.model == second.problem.model and not (
        first.problem.tied or second.problem.tied
    )


def beside_shared(known: Diagnosis, word: str, other: Diagnosis, say: Say | None) -> BesideShared:
    """What the ``other`` state has and the ``known`` one has not; ``word`` says which that is."""
    base = with_remainder(_named(known), known.remainder)
    every = [*_of_state(known, word), *other.problem.recordings]
    given = len(known.problem.model.effects)
    names = frozenset(one.name for one in every[: len(known.problem.recordings)])
    problem = BothStates(every, base, known=names, tied=law_knobs(base, given))
    selection = select(problem, say, {EMPIRICAL}, known.selection.settled)
    judged = other.judged
    weighed: Problem = problem
    told = shown = selection
    if left_of(problem, selection, judged) is not None:
        weighed, told = selected_beside(selection)
    findings = _supported(weighed, told, other)
    if weighed is not problem and problem.tied and not findings:
        apart = problem.apart([one.prepared for one in judged])
        named = _supported(problem, selection, other)
        named = outweighing(problem, selection, named, apart)
        if named:
            weighed, told, findings = problem, selection, named
    placebo = placebos(weighed, told, findings, judged)
    lucky = as_lucky(placebo, weighed, told, findings, judged)
    if lucky:
        kept = [k for k in findings if told.found.entries[k]["effect"] not in lucky]
        findings = standing(weighed, told, kept, judged)
        placebo = placebos(weighed, told, findings, judged)
    if weighed is not problem:
        shown = not_whitened(problem, told, selection)
    written = one_state(augmented_by(problem, shown.found, findings))
    shared = left_of(problem, shown, judged)
    left = shared if _more_left(problem, shown) else None
    content = content_of(problem, shown, findings, left, judged, None, written)
    content["fit"]["placebo"] = placebo
    content["fit"]["improvement"] = improvement(
        Judged(judged, base), Judged(judged, written), base, written
    )
    content["limits"] = [_SHARED, *([] if shared is None or left is not None else [_LEFT])]
    content = only_if_clear(content)
    diagnosis = replace(
        other,
        content=without_nan(content),
        model=written,
        problem=problem,
        selection=shown,
        accepted=findings,
        remainder=None,
        as_read=(),
        price=price(problem, shown, findings, judged, written),
    )
    figures = content["fit"]["holdout"]["baseline"]
    assert isinstance(weighed, BothStates)
    way = BesideShared(known, diagnosis, base, word, figures, weighed=weighed, told_there=told)
    old = way.not_new()
    said = way.joined(old)[1]
    return replace(way, old=tuple(old), limits=tuple(said))


def _supported(problem: Problem, told: Selection, other: Diagnosis) -> Sequence[int]:
    """Places of what was ``told`` that the other state's hold-outs bear out."""
    findings = holdout_support(problem, told, other.judged)
    findings = settled(problem, told, findings, other.ratio_is_measured)[0]
    return standing(problem, told, findings, other.judged)


def gain(way: BesideShared) -> float:
    """What its changes gain (noise variances), less the price of the names in both states."""
    selection = way.other.selection
    entries = selection.found.entries
    new = {str(one["effect"]) for _, one in way.told()}
    gained = sum(
        selection.gains.get(term_of(entries[k]), 0.0)
        for k in way.other.accepted
        if str(entries[k]["effect"]) in new
    )
    return gained - 2.0 * LEAST * len(way.known.accepted)


def _named(known: Diagnosis) -> Any:
    """The given model with the names of the known state."""
    return augmented_by(known.problem, known.selection.found, known.accepted)


def _of_state(known: Diagnosis, word: str) -> list[Prepared]:
    """The known state's recordings by names of their own."""
    return [one.changed(name=f"{one.name} ({word})") for one in known.problem.recordings]


def _more_left(problem: BothStates, shown: Selection) -> bool:
    """Whether clearly more is left without a name in the other state than in the known one."""
    residual = clipped(shown.found.residual, knee(shown.found.residual))
    known, use = problem.in_known(), problem.sliding
    beyond: Mapping[bool, float] = {
        side: float(np.mean(residual[use & (known == side)] ** 2)) - 1.0 for side in (True, False)
    }
    return beyond[False] > MORE * max(beyond[True], 1.0)
