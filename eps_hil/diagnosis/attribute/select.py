"""Which effects: first those that no refit of the model's own numbers could replace, then which of
those numbers are off, then whether fewer names would do.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.attribute.exchange import bettered, exchanged
from eps_hil.diagnosis.attribute.lag import as_dead_time, as_lag
from eps_hil.diagnosis.attribute.numbers import SCALES, SPANNED, levels_first, numbers_off
from eps_hil.diagnosis.attribute.scoring import (
    FINAL_SHARE,
    FORWARD_SHARE,
    IN_CURVE,
    NEAR,
    Scored,
    is_curve,
    penalised,
    score,
    threshold,
)
from eps_hil.diagnosis.balance.baseline import ALL, HOLD, TIMING
from eps_hil.diagnosis.balance.excerpt import excerpt
from eps_hil.diagnosis.balance.fit import FARTHEST_OWN, Fit, ablated, deviation, fit, matters
from eps_hil.diagnosis.balance.probes import Candidate, candidates
from eps_hil.diagnosis.balance.problem import Problem, knee, term_of
from eps_hil.diagnosis.balance.reference import OF_MOTOR, gain_is_observable
from eps_hil.diagnosis.mismatch.curve import ID as CURVE
from eps_hil.diagnosis.mismatch.curve import has_curve, levelled, with_curve

Floats = npt.NDArray[np.float64]

MOST_EFFECTS = 8
CURVE_MARGIN = 0.6
"""A free curve is only looked at where no simpler effect reaches this share of its gain."""
_CURVE_ROUNDS = 3
FARTHEST = 3.0
"""Usual errors by which a believable refit moves the model's own numbers at most."""
LATEST = 0.99 * FARTHEST_OWN
"""The same of the motor torque's delay: what ends where a fit stops is no delay."""


Say = Callable[[str, float], None]


@dataclass
class Selection:
    """The accepted effects' fit, the null's, and for each term what else was nearly as good.

    ``without``: for each accepted term the fit that does without it, the others refitted.
    ``settled``: constants that a sensor with nothing on it has ruled out, but for the ``possible``.
    ``pool`` and ``searched``, the fit it belongs to, are of the problem ``part`` that was searched.
    """

    null: Fit
    found: Fit
    pool: list[Candidate]
    part: Problem
    searched: Fit
    rivals: dict[str, list[tuple[str, float]]] = field(default_factory=dict)
    gains: dict[str, float] = field(default_factory=dict)
    without: dict[str, Fit] = field(default_factory=dict)
    settled: frozenset[str] = frozenset()
    possible: frozenset[str] = frozenset()
    least: dict[str, float] = field(default_factory=dict)
    """Gain that counts of each name that was weighed beside a remainder."""


def select(
    problem: Problem,
    say: Say | None = None,
    without: Collection[str] = (),
    settled: Collection[str] = (),
) -> Selection:
    """Effects that the recordings show, searched for in an excerpt if there are hours of them.

    ``without``: ids of effects that are not considered; ``settled``: constants that are not what a
    constant is called in the end.
    """
    part = excerpt(problem)
    selection = _search(part, say, without, frozenset(settled))
    return selection if part is problem else _on_all(problem, selection)


def _on_all(problem: Problem, selection: Selection) -> Selection:
    """What was found in a part, fitted to everything; what everything does not need is dropped."""
    problem.at, found = selection.part.at, selection.found
    problem.beyond_nm = selection.part.beyond_nm
    found = fit(problem, found.entries, own=found.own)
    problem.knee = knee(found.residual)
    found = fit(problem, found.entries, own=found.own, like=found)
    if has_curve(found):
        found = _curved(problem, found) or found
    selection.found = timed(problem, _backward(problem, found))
    selection.null = fit(problem, [], own={**TIMING, **problem.tied})
    rivals = selection.rivals
    selection.gains, selection.without, selection.rivals = {}, {}, {}
    for _, entry in _ablations(problem, selection):
        selection.rivals[term_of(entry)] = rivals.get(term_of(entry), [])
    return selection


def _search(
    problem: Problem, say: Say | None, without: Collection[str], settled: frozenset[str]
) -> Selection:
    """Structures beside a free baseline, then the baseline's own deviations by name.

    The regressors are taken once, at the refitted model without effects; each step's fit is exact.
    """
    found = fit(problem, [], own={**ALL, **problem.tied})
    if problem.weigh(problem.with_entries([], found.own)):
        found = fit(problem, [], own={**ALL, **problem.tied})
        problem.weigh(problem.with_entries([], found.own))
    problem.at, problem.columns = found.own if _believable(found) else {}, {}
    problem.knee = knee(found.residual)
    null, found = fit(problem, [], own={**TIMING, **problem.tied}), fit(problem, [], own=found.own)
    here = _where_to_look(problem, found)
    pool = candidates(
        problem,
        here.entries,
        here.residual,
        (lambda part: say("taking sensitivities", part)) if say else None,
        here.own,
        without,
    )
    # of a rack that nothing loads no gain is named in the end, but the search goes by it
    if any(np.any(one.raw.get("rack_force_n", 0.0)) for one in problem.recordings):
        pool = [
            one
            for one in pool
            if one.effect.id not in (*SCALES, *OF_MOTOR) or gain_is_observable(problem, one.columns)
        ]
    selection = Selection(null, found, pool, problem, found, settled=settled)
    structures = [one for one in pool if one.effect.id not in SPANNED]
    curves = any(is_curve(one) for one in structures)
    for step in range(MOST_EFFECTS):
        if say:
            say("attributing", step / MOST_EFFECTS)
        here = _where_to_look(problem, found)
        chosen = _best(problem, found, here, score(problem, here, structures))
        if chosen is None and curves:
            chosen = _curved(problem, found)
        if chosen is None:
            break
        found = _without_neutral(problem, chosen)
        problem.weigh(problem.with_entries(found.entries, found.own))
        problem.knee = knee(found.residual)
        found = fit(problem, found.entries, own=found.own, like=found)
    if has_curve(found):
        found = _curve_alone(problem, _curved(problem, found) or found)
    found = _backward(problem, found)
    least = threshold(problem, found.residual, FORWARD_SHARE)
    refitted, found = found, numbers_off(problem, found, pool, least)
    if has_curve(found):
        found = levelled(problem, found) or numbers_off(problem, refitted, pool, least, level=False)
    found = _backward(problem, as_lag(problem, found))
    found = bettered(problem, exchanged(problem, found, pool), pool)
    considered = {one.effect.id for one in pool}
    least = threshold(problem, found.residual, FORWARD_SHARE)
    found = levels_first(problem, found, least, considered, settled)
    found = _backward(problem, found)
    if problem.weigh(problem.with_entries(found.entries, found.own)):
        selection.null = fit(problem, [], own=null.own)
        found = fit(problem, found.entries, own=found.own, like=found)
    selection.found = selection.searched = timed(problem, found)
    rivals_of(problem, selection)
    return selection


def _believable(found: Fit) -> bool:
    """Whether the model's own numbers stayed within what errors of them may be.

    How late the motor's torque is bends no other number: it may be as late as it is looked for.
    """
    return all(abs(v) < (LATEST if name == HOLD else FARTHEST) for name, v in found.own.items())


def _where_to_look(problem: Problem, found: Fit) -> Fit:
    """The fit; or the same effects on the model file's own numbers, if the refit bent those out of
    all reason to make up for what is missing: nothing can be recognised beside such a model.
    """
    if _believable(found):
        return found
    return fit(problem, found.entries, 0, dict.fromkeys(found.own, 0.0))


def _best(problem: Problem, found: Fit, here: Fit, scored: Sequence[Scored]) -> Fit | None:
    """Refit from ``here`` with each of the best few of different effects; keep the one that fits
    best, if it does better than ``found``.
    """
    least = threshold(problem, found.residual, FORWARD_SHARE)
    simple = max((one.gain for one in scored if not is_curve(one.candidate)), default=0.0)
    scored = [
        one for one in scored if not is_curve(one.candidate) or simple < CURVE_MARGIN * one.gain
    ]
    shortlist: list[Scored] = []
    for one in scored:
        if one.gain < least or len(shortlist) == 3 or one.gain < 0.5 * scored[0].gain:
            break
        if all(one.candidate.effect.id != other.candidate.effect.id for other in shortlist):
            shortlist.append(one)
    fits = [fit(problem, [*here.entries, one.entry], own=here.own, like=here) for one in shortlist]
    fits = [one for one in fits if found.cost - one.cost > least]
    return min(fits, key=penalised, default=None)


def _curved(problem: Problem, found: Fit) -> Fit | None:
    """The fit with a curve over position where that still bends, if it is worth its knots.

    In the place of what such a curve holds already: both at once would cancel each other.
    """
    others = [entry for entry in found.entries if entry["effect"] not in IN_CURVE]
    bare = found if len(others) == len(found.entries) else fit(problem, others, own=found.own)
    trial = with_curve(problem, bare)
    least = threshold(problem, found.residual, FORWARD_SHARE)
    had = has_curve(found)
    better = penalised(found) - penalised(trial)
    return trial if better > (0.0 if had else least) else None


def _curve_alone(problem: Problem, found: Fit) -> Fit:
    """Without the effects in whose place the curve, with knots of its own choice, does as well.

    What was found before the curve may be a part of it.
    """
    k = 0
    while k < len(found.entries):
        if found.entries[k]["effect"] != CURVE:
            trial = _settled(problem, with_curve(problem, ablated(problem, found, k)))
            least = threshold(problem, found.residual, FINAL_SHARE)
            if penalised(trial) < penalised(found) + least:
                found, k = trial, -1
        k += 1
    return found


def _settled(problem: Problem, found: Fit) -> Fit:
    """Knots are put where they are wanted beside a fit; that fit moves once they are there."""
    for _ in range(_CURVE_ROUNDS):
        trial = with_curve(problem, found)
        if penalised(found) - penalised(trial) < threshold(problem, found.residual, FINAL_SHARE):
            return found
        found = trial
    return found


def _backward(problem: Problem, found: Fit) -> Fit:
    """Drop, one at a time, what the others can do without."""
    while found.entries:
        without = [ablated(problem, found, k) for k in range(len(found.entries))]
        losses = [one.cost - found.cost for one in without]
        weakest = int(np.argmin(losses))
        if losses[weakest] > threshold(problem, found.residual, FINAL_SHARE):
            return found
        found = without[weakest]
    return found


def _without_neutral(problem: Problem, found: Fit) -> Fit:
    keep = [e for e in found.entries if deviation(e, problem) > 1e-9]
    if len(keep) == len(found.entries):
        return found
    return fit(problem, keep, own=found.own)


def timed(problem: Problem, found: Fit) -> Fit:
    """How a torque is held is free again where no delay worth a name stands for it.

    And it is not where one does: both would pull against each other.
    """
    (name,) = TIMING
    entries = [e for e in found.entries if e["effect"] != name or matters(e, problem)]
    named = any(entry["effect"] == name for entry in entries)
    if named == (name not in found.own):
        return as_dead_time(problem, found)
    own = {key: value for key, value in found.own.items() if key != name}
    return fit(problem, entries, own=own if named else {**TIMING, **own}, like=found)


def _ablations(problem: Problem, selection: Selection) -> Iterator[tuple[Fit, Mapping[str, Any]]]:
    """The fit without each accepted entry, and that entry; its gain is noted down."""
    found = selection.found
    for k, entry in enumerate(found.entries):
        if not matters(entry, problem):
            continue
        without = ablated(problem, found, k)
        selection.gains[term_of(entry)] = without.cost - found.cost
        selection.without[term_of(entry)] = without
        yield without, entry


def rivals_of(problem: Problem, selection: Selection) -> None:
    """For each accepted effect: what others reach in its place, as a share of its gain."""
    for without, entry in _ablations(problem, selection):
        gain = selection.gains[term_of(entry)]
        near: dict[str, float] = {}
        for one in score(problem, without, selection.pool):
            name = one.candidate.effect.id
            if name == entry["effect"] or name in near or one.gain < NEAR * gain:
                continue
            if is_curve(one.candidate):
                continue  # by its definition what no other effect explains, so nobody's rival
            own = selection.found.own
            refitted = fit(problem, [*without.entries, one.entry], own=own, like=without)
            near[name] = (without.cost - refitted.cost) / max(gain, 1e-9)
        selection.rivals[term_of(entry)] = sorted(near.items(), key=lambda pair: -pair[1])
