"""Which effects: first those that no refit of the model's own numbers could replace, then which of
those numbers are off, then whether fewer names would do.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.baseline import ALL, TIMING
from eps_hil.diagnosis.curve import ID as CURVE
from eps_hil.diagnosis.curve import with_curve
from eps_hil.diagnosis.fit import Fit, ablated, deviation, fit, matters
from eps_hil.diagnosis.numbers import SPANNED, levels_first, numbers_off
from eps_hil.diagnosis.probes import Candidate, candidates
from eps_hil.diagnosis.problem import Problem, clipped, knee

Floats = npt.NDArray[np.float64]

LEAST_SHARE = 0.006
"""Least share of the residual's energy that an accepted effect explains on unfitted blocks."""
LEAST_GAIN = 30.0
"""Least gain in units of the noise's own variance."""
MOST_EFFECTS = 8
CURVE_MARGIN = 0.6
"""A free curve is only looked at where no simpler effect reaches this share of its gain."""
FORWARD_SHARE, FINAL_SHARE = 0.02, 0.10
"""Least shares of what is still unexplained: on the way, and in the end."""
FARTHEST = 3.0
"""Usual errors by which a believable refit moves the model's own numbers at most."""
NEAR = 0.8
"""A candidate that reaches this share of a finding's gain is fitted in its place."""

_IN_CURVE = ("unmodelled_spring", "end_stop")
"""A static curve over position holds these already; both at once would cancel each other."""

Say = Callable[[str, float], None]


@dataclass(frozen=True)
class Scored:
    """A candidate, its held-out gain (noise variances), and the entry to start a fit from."""

    candidate: Candidate
    gain: float
    entry: dict[str, Any]


@dataclass
class Selection:
    """The accepted effects' fit, the null's, and for each effect what else was nearly as good.

    ``without``: for each accepted effect the fit that does without it, the others refitted.
    """

    null: Fit
    found: Fit
    pool: list[Candidate]
    rivals: dict[str, list[tuple[str, float]]] = field(default_factory=dict)
    gains: dict[str, float] = field(default_factory=dict)
    without: dict[str, Fit] = field(default_factory=dict)


def select(problem: Problem, say: Say | None = None, without: Collection[str] = ()) -> Selection:
    """Structures beside a free baseline, then the baseline's own deviations by name.

    The regressors are taken once, at the refitted model without effects; each step's fit is exact.
    ``without``: ids of effects that are not considered.
    """
    found = fit(problem, [], own={**ALL, **problem.tied})
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
    selection = Selection(null, found, pool)
    structures = [one for one in pool if one.effect.id not in SPANNED]
    curves = any(_is_curve(one) for one in structures)
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
        problem.knee = knee(found.residual)
        found = fit(problem, found.entries, own=found.own, like=found)
    if any(entry["effect"] == CURVE for entry in found.entries):
        found = _curved(problem, found) or found
    found = _backward(problem, found)
    found = numbers_off(problem, found, pool, threshold(problem, found.residual, FORWARD_SHARE))
    found = _backward(problem, found)
    found = _exchanged(problem, found, pool)
    considered = {one.effect.id for one in pool}
    least = threshold(problem, found.residual, FORWARD_SHARE)
    found = _backward(problem, levels_first(problem, found, least, considered))
    selection.found = timed(problem, found)
    _rivals(problem, selection)
    return selection


def _believable(found: Fit) -> bool:
    """Whether the model's own numbers stayed within what errors of them may be."""
    return all(abs(value) < FARTHEST for value in found.own.values())


def _where_to_look(problem: Problem, found: Fit) -> Fit:
    """The fit; or the same effects on the model file's own numbers, if the refit bent those out of
    all reason to make up for what is missing: nothing can be recognised beside such a model.
    """
    if _believable(found):
        return found
    return fit(problem, found.entries, 0, dict.fromkeys(found.own, 0.0))


def score(problem: Problem, found: Fit, pool: Sequence[Candidate]) -> list[Scored]:
    """Every candidate's gain on held-out blocks, best first."""
    results = []
    basis = _basis(found.jacobian)
    taken = {entry["effect"] for entry in found.entries}
    for candidate in pool:
        if candidate.effect.id in taken or (CURVE in taken and candidate.effect.id in _IN_CURVE):
            continue
        gain, coefficients = _cross_validated(problem, found.residual, candidate.columns, basis)
        entry = candidate.entry(coefficients, problem)
        if deviation(entry, problem) > 0.0:  # of the other sign it is not this effect
            results.append(Scored(candidate, gain, entry))
    return sorted(results, key=lambda one: -one.gain)


def threshold(problem: Problem, residual: Floats, of_excess: float) -> float:
    """Gain that counts beside what the residual still holds.

    ``of_excess`` is the share of the energy beyond the sensor noise that it must explain: an
    effect that leaves most of the mismatch standing has the wrong name.
    """
    energy = clipped(residual, knee(residual)) ** 2
    excess = float(np.sum(energy[problem.sliding] - 1.0))
    return max(LEAST_GAIN, LEAST_SHARE * float(np.sum(energy)), of_excess * excess)


def _best(problem: Problem, found: Fit, here: Fit, scored: Sequence[Scored]) -> Fit | None:
    """Refit from ``here`` with each of the best few of different effects; keep the one that fits
    best, if it does better than ``found``.
    """
    least = threshold(problem, found.residual, FORWARD_SHARE)
    simple = max((one.gain for one in scored if not _is_curve(one.candidate)), default=0.0)
    scored = [
        one for one in scored if not _is_curve(one.candidate) or simple < CURVE_MARGIN * one.gain
    ]
    shortlist: list[Scored] = []
    for one in scored:
        if one.gain < least or len(shortlist) == 3 or one.gain < 0.5 * scored[0].gain:
            break
        if all(one.candidate.effect.id != other.candidate.effect.id for other in shortlist):
            shortlist.append(one)
    fits = [fit(problem, [*here.entries, one.entry], own=here.own, like=here) for one in shortlist]
    fits = [one for one in fits if found.cost - one.cost > least]
    return min(fits, key=_penalised, default=None)


def _curved(problem: Problem, found: Fit) -> Fit | None:
    """The fit with a curve over position where that still bends, if it is worth its knots."""
    trial = with_curve(problem, found)
    least = threshold(problem, found.residual, FORWARD_SHARE)
    had = any(entry["effect"] == CURVE for entry in found.entries)
    better = _penalised(found) - _penalised(trial)
    return trial if better > (0.0 if had else least) else None


def _is_curve(candidate: Candidate) -> bool:
    probe = candidate.effect.probe
    return probe is not None and probe.scan == "curve"


def _penalised(one: Fit) -> float:
    """Cost with Schwarz's price, ln n, for every number fitted, a curve's knots included."""
    knots = sum(len(entry["curve"]) for entry in one.entries if "curve" in entry)
    return one.cost + float(np.log(len(one.residual))) * (len(one.names) + knots)


def _cross_validated(
    problem: Problem, residual: Floats, columns: Floats, basis: Floats
) -> tuple[float, Floats]:
    """(held-out gain, coefficients from all blocks) of regressing the residual on the columns.

    What the parameters already in the model could do is projected out of the columns first.
    """
    if basis.shape[1]:
        columns = columns - basis @ (basis.T @ columns)
        if np.linalg.norm(columns) < 1e-6:
            return 0.0, np.zeros(columns.shape[1])
    cut = clipped(residual, knee(residual))
    norm = np.sqrt(np.sum(columns**2, axis=0)) + 1e-300
    scaled = columns / norm
    gain = 0.0
    for part in (0, 1):
        fitted, judged = problem.block % 2 == part, problem.block % 2 != part
        a = np.linalg.lstsq(scaled[fitted], cut[fitted], rcond=1e-9)[0]
        guess = scaled[judged] @ a
        gain += float(np.sum(cut[judged] ** 2 - (cut[judged] - guess) ** 2))
    whole = np.linalg.lstsq(scaled, cut, rcond=1e-9)[0]
    return gain, whole / norm


def _basis(jacobian: Floats) -> Floats:
    if jacobian.shape[1] == 0:
        return jacobian
    size = np.sqrt(np.sum(jacobian**2, axis=0))
    q, r = np.linalg.qr(jacobian[:, size > 0] / size[size > 0])
    return np.asarray(q[:, np.abs(np.diag(r)) > 1e-6])


def _without_neutral(problem: Problem, found: Fit) -> Fit:
    keep = [e for e in found.entries if deviation(e, problem) > 1e-9]
    if len(keep) == len(found.entries):
        return found
    return fit(problem, keep, own=found.own)


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


def timed(problem: Problem, found: Fit) -> Fit:
    """How a torque is held is free again where no delay worth a name stands for it."""
    (name,) = TIMING
    entries = [e for e in found.entries if e["effect"] != name or matters(e, problem)]
    if name in found.own or any(entry["effect"] == name for entry in entries):
        return found
    return fit(problem, entries, own={**TIMING, **found.own}, like=found)


def _exchanged(problem: Problem, found: Fit, pool: Sequence[Candidate]) -> Fit:
    """One effect in the place of two, where it does as well: fewer names explain as much."""
    changed = True
    while changed and len(found.entries) > 1:
        changed = False
        least = threshold(problem, found.residual, FORWARD_SHARE)
        for pair in combinations(range(len(found.entries)), 2):
            others = [e for i, e in enumerate(found.entries) if i not in pair]
            without = fit(problem, others, 6, found.own, found)
            loss = without.cost - found.cost
            best = score(problem, without, pool)[:1]
            if not best or best[0].gain < NEAR * loss:
                continue
            trial = fit(problem, [*without.entries, best[0].entry], own=found.own, like=without)
            if trial.cost < found.cost + least:
                found, changed = trial, True
                break
    return found


def _rivals(problem: Problem, selection: Selection) -> None:
    """For each accepted effect: what others reach in its place, as a share of its gain."""
    found = selection.found
    for k, entry in enumerate(found.entries):
        if not matters(entry, problem):
            continue
        without = ablated(problem, found, k)
        gain = without.cost - found.cost
        selection.gains[entry["effect"]] = gain
        selection.without[entry["effect"]] = without
        near: dict[str, float] = {}
        for one in score(problem, without, selection.pool):
            name = one.candidate.effect.id
            if name == entry["effect"] or name in near or one.gain < NEAR * gain:
                continue
            if _is_curve(one.candidate):
                continue  # by its definition what no other effect explains, so nobody's rival
            refitted = fit(problem, [*without.entries, one.entry], own=found.own, like=without)
            near[name] = (without.cost - refitted.cost) / max(gain, 1e-9)
        selection.rivals[entry["effect"]] = sorted(near.items(), key=lambda pair: -pair[1])


def entries_of(found: Fit) -> list[Mapping[str, Any]]:
    """The fitted entries, as a model file holds them."""
    return [dict(entry) for entry in found.entries]
