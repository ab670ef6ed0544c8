"""Names beside a law: what has no name is modelled first, and names are looked for beside it.

A free discrepancy holds whatever is smooth over a signal, so a spring or a friction curve gains
next to nothing beside one. A law of few numbers does not: where one takes most of the excess off
recordings that it never saw, it joins the model, its numbers free in every fit, and the ordinary
search runs once more on what is left. A name is judged by what it gains there on hold-outs,
everything else and the law refitted, and against the law that would do best in its place.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.holdout_support import augmented_by, holdout_support, refitted
from eps_hil.diagnosis.accept.measured_ratio import settled
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.accept.standing import standing
from eps_hil.diagnosis.attribute.scoring import FINAL_SHARE, threshold
from eps_hil.diagnosis.attribute.select import Say, Selection, rivals_of, select
from eps_hil.diagnosis.balance.baseline import law_knobs, of_law
from eps_hil.diagnosis.balance.fit import Fit, fit
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee, term_of
from eps_hil.diagnosis.mismatch.curve import ID as CURVE
from eps_hil.diagnosis.mismatch.curve import has_curve
from eps_hil.diagnosis.mismatch.leftover import BESIDE_UNKNOWN, Leftover, leftover
from eps_hil.diagnosis.remainder.find import Remainder, Term, find, share_removed
from eps_hil.diagnosis.remainder.grammar import columns_of
from eps_hil.diagnosis.remainder.screen import screen
from eps_hil.diagnosis.remainder.sight import Sight
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

_LEARNT = "empirical"
MOST_LAWS = 2
ENOUGH = 0.9
"""Share of the hold-outs' excess that laws and names together have to take off: beside a law that
leaves much, names would stand in for the rest."""
_BETTER, _UNNEEDED, _ALONG = 1.02, 0.5, 0.1
"""A law in a name's place is better if it gains the first times as much, and by the third of what
stays unexplained more: the best of thousands takes some of that along. The name is then unneeded if
less than the second share of its gain is left beside that law."""
_NEARLY_ALL = 0.9
"""Of the energy of what a name does: the blocks of time in which it acts."""
_HOLDS, _MOST = 4.0, 0.5
"""Energy in units of the noise's up to which a law holds in a block of time, and the share of the
samples at which a name acts that such blocks need to have for the name to be judged by them."""


@dataclass(frozen=True)
class BesideLaw:
    """What was found: the problem with the laws in its model, and the names there.

    ``selection`` is of the problem without laws, at the same numbers, as figures and words need it.
    """

    weighed: Problem
    told: Selection
    selection: Selection
    findings: Sequence[int]
    remainder: Remainder


def beside_law(
    problem: Problem,
    starts: Sequence[tuple[Selection, Sequence[int]]],
    judged: Sequence[Holdout],
    *,
    measured: bool,
    say: Say | None = None,
) -> BesideLaw | None:
    """Names beside at most :data:`MOST_LAWS` laws; None where none stands there.

    ``starts``: names that were found without laws, beside which the first law is looked for; the
    next ones only where there is no law beside those before. ``measured``: whether rotor against
    rack has measured the ratio, which is then no name.
    """
    tried: list[set[str]] = []
    for selection, findings in starts:
        names = {str(selection.found.entries[k]["effect"]) for k in findings}
        if names in tried:
            continue
        tried.append(names)
        there, found = _from(problem, selection, findings, judged, measured=measured, say=say)
        if there:
            return None if found is None else _with_more(problem, found, judged)
    return None


def _from(
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    judged: Sequence[Holdout],
    *,
    measured: bool,
    say: Say | None,
) -> tuple[bool, BesideLaw | None]:
    """Names and laws in turns, first a law beside the ``findings``; whether there was one, and
    what stands beside it.
    """
    kept = problem.apart([one.prepared for one in judged])
    without = set(catalogue()) - {one.effect.id for one in selection.pool}
    first = len(problem.model.effects)
    model = augmented_by(problem, selection.found, findings)
    start, jacobian = Sight(kept, problem.model), _columns(selection, findings)
    laws: list[Mapping[str, Any]] = []
    best: BesideLaw | None = None
    for step in range(MOST_LAWS):
        if say is not None:
            say("looking for a law beside the names", step / MOST_LAWS)
        law = find(problem, kept, model, jacobian, one_law=True)
        if law is None:
            return step > 0, best
        laws = [*laws, *law.entries]
        given = replace(problem.model, effects=(*problem.model.effects, *laws))
        again = Problem(problem.recordings, given, tied=law_knobs(given, first))
        told, named = names_beside(again, selection, without, judged, measured=measured, say=say)
        model, jacobian = augmented_by(again, told.found, named, moved=True), _columns(told, named)
        # names that the first law's own faults outweigh may stand beside a second one
        good = outweighing(again, told, named, kept)
        if good:
            model, jacobian = (
                augmented_by(again, told.found, good, moved=True),
                _columns(told, good),
            )
        laws = list(model.effects[first : first + len(laws)])
        if good and share_removed(start, kept.residual(model))[0] > ENOUGH:
            best = beside_laws(problem, selection, again, told, good, kept, model, laws)
        if _left(again, told, kept) is None:
            break
    return True, best


def names_beside(
    problem: Problem,
    before: Selection,
    without: set[str],
    judged: Sequence[Holdout],
    *,
    measured: bool,
    say: Say | None = None,
) -> tuple[Selection, Sequence[int]]:
    """A search for names beside laws, and those that hold-outs bear out.

    A free curve takes along what a law that is not exact leaves anywhere on the travel: one that
    hold-outs refuse may have been a simpler name, which is searched for without it.
    """
    for apart in (without, without | {CURVE}):
        told = select(problem, say, apart, before.settled)
        told.possible = before.possible
        curve = has_curve(told.found)
        named = holdout_support(problem, told, judged)
        named = standing(problem, told, settled(problem, told, named, measured)[0], judged)
        if not curve or any(told.found.entries[k]["effect"] == CURVE for k in named):
            break
    return told, named


def _with_more(problem: Problem, found: BesideLaw, judged: Sequence[Holdout]) -> BesideLaw:
    """With what stays unknown beside names and laws modelled, too, curves and maps among it."""
    kept = problem.apart([one.prepared for one in judged])
    jacobian, before = _columns(found.told, found.findings), found.remainder
    more = find(problem, kept, before.model, jacobian)
    if more is None:
        return found
    start = augmented_by(problem, found.selection.found, found.findings)
    share, ends = share_removed(Sight(kept, start), kept.residual(more.model))
    both = replace(
        before,
        terms=(*before.terms, *more.terms),
        model=more.model,
        share=share,
        ci95=ends,
        after=more.after,
    )
    return replace(found, remainder=both)


def _columns(selection: Selection, findings: Sequence[int]) -> Floats:
    """Sensitivities to the model's own numbers, the laws' and those of the findings."""
    found = selection.found
    named = [len(found.own) + i for i, (k, _) in enumerate(found.names) if k in findings]
    return np.asarray(found.jacobian[:, [*range(len(found.own)), *named]])


def _left(problem: Problem, told: Selection, kept: Problem) -> Leftover | None:
    found = told.found
    test = problem.over(kept.recordings)
    after = test.residual(test.with_entries(found.entries, found.own))
    return leftover(problem, found.residual, (test, after))


def outweighing(
    problem: Problem, told: Selection, named: Sequence[int], kept: Problem
) -> Sequence[int]:
    """Places of the names that explain more than what stays unexplained, and for which no law
    would do better; the others go, and what is left is fitted and asked once more.
    """
    while named:
        good = [
            k
            for k in named
            if _outweighs(problem, told, k) and not _law_instead(problem, told, [k], kept)
        ]
        if len(good) == len(named):
            several = len(named) > 1
            return [] if several and _law_instead(problem, told, named, kept) else named
        named = refitted(problem, told, good)
        rivals_of(problem, told)
    return []


def _outweighs(problem: Problem, told: Selection, place: int) -> bool:
    """Whether a name gains what it needs, everywhere or where the laws hold.

    A law that fails for a while (an iron loss while the inverter is off) says nothing of a name
    that gains as much in most of the other time.
    """
    found, term = told.found, term_of(told.found.entries[place])
    if told.gains[term] >= unexplained(problem, found, place):
        return True
    acts = _acting(problem, found, place)
    at = knee(found.residual)
    left = np.where(acts, np.minimum(np.abs(found.residual), at) ** 2 - 1.0, 0.0)
    of_block = np.bincount(problem.block, left) / np.maximum(np.bincount(problem.block, acts), 1)
    holds = acts & (of_block <= _HOLDS - 1.0)[problem.block]
    if np.sum(holds) < _MOST * np.sum(acts):
        return False
    other = told.without[term]
    without = problem.residual(problem.with_entries(other.entries, other.own))
    gain = clipped(without, at) ** 2 - clipped(found.residual, at) ** 2
    return float(np.sum(gain[holds])) >= BESIDE_UNKNOWN * float(np.sum(left[holds]))


def unexplained(problem: Problem, found: Fit, place: int | None = None) -> float:
    """The gain that a name beside laws needs: twice what both leave unexplained where it acts.

    ``place``: of the name, everywhere without one. What a law leaves while the drive is off says
    nothing of a name that acts while it is on. Whole blocks of time count: at places that are
    passed in between, a law's fault may go on of which the name takes a part.
    """
    acts = problem.sliding if place is None else _acting(problem, found, place)
    size = np.minimum(np.abs(found.residual), knee(found.residual))[acts]
    return BESIDE_UNKNOWN * float(np.sum(size**2 - 1.0))


def _acting(problem: Problem, found: Fit, place: int) -> npt.NDArray[np.bool_]:
    """Samples (n,) that slide in the blocks of time in which an entry acts."""
    others = [entry for i, entry in enumerate(found.entries) if i != place]
    alone = problem.residual(problem.with_entries(others, found.own)) - found.residual
    energy = np.bincount(problem.block, np.where(problem.sliding, alone**2, 0.0))
    return np.asarray(problem.sliding & _most(energy)[problem.block])


def _most(energy: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Which are the largest that make up nearly all of the sum."""
    falling = np.sort(energy)[::-1]
    sums = np.cumsum(falling)
    return np.asarray(energy >= falling[np.searchsorted(sums, _NEARLY_ALL * sums[-1])])


def _law_instead(problem: Problem, told: Selection, places: Sequence[int], kept: Problem) -> bool:
    """Whether one law in the place of names does better, and leaves nothing to them.

    Of several names it need not do better: it takes the place of more numbers.
    """
    found = told.found
    others = [entry for i, entry in enumerate(found.entries) if i not in places]
    model = problem.with_entries(others, found.own)
    here, there = Sight(problem, model), Sight(problem.over(kept.recordings), model)
    first = len(found.own)
    its = [first + i for i, (place, _) in enumerate(found.names) if place in places]
    beside = np.delete(found.jacobian, its, axis=1)
    column = columns_of(screen(here, there, beside).best[0].law, here)
    if column is None:
        return False
    rows, weight = here.rows, here.weight[here.rows, None]
    basis = _basis(beside[rows] * weight)

    def free(columns: Floats) -> Floats:
        columns = columns * weight
        return np.asarray(columns - basis @ (basis.T @ columns))

    law = free(column / here.scale[rows, None])
    name = free((found.residual - here.residual)[rows, None])
    left = free(here.residual[rows, None])[:, 0]

    def gain(columns: Floats) -> float:
        size = np.linalg.lstsq(columns, left, rcond=1e-9)[0]
        return float(left @ columns @ size)

    by_law, by_name, both = gain(law), gain(name), gain(np.hstack([law, name]))
    better = _BETTER if len(places) == 1 else 1.0 / _BETTER
    shown = len(rows) / max(int(np.sum(problem.sliding)), 1)
    along = _ALONG * shown * max(unexplained(problem, found), 0.0) / BESIDE_UNKNOWN
    return by_law > better * by_name + along and both - by_law < _UNNEEDED * by_name


def without_laws(problem: Problem, found: Fit) -> Fit:
    """A fit beside laws in terms of the ``problem`` that has none, at the same numbers."""
    own = {name: value for name, value in found.own.items() if not of_law(name)}
    return replace(fit(problem, found.entries, 0, own), told_half_width=found.half_width)


def names_first(problem: Problem, model: Model) -> Model:
    """The model with its laws behind the names, as where names were found before any law."""
    first = len(problem.model.effects)
    given, rest = model.effects[:first], model.effects[first:]
    names = tuple(one for one in rest if one["effect"] != _LEARNT)
    learnt = tuple(one for one in rest if one["effect"] == _LEARNT)
    return replace(model, effects=(*given, *names, *learnt))


def _basis(columns: Floats) -> Floats:
    size = np.sqrt(np.sum(columns**2, axis=0))
    q, r = np.linalg.qr(columns[:, size > 0.0] / size[size > 0.0])
    return np.asarray(q[:, np.abs(np.diag(r)) > 1e-6])


def beside_laws(
    problem: Problem,
    before: Selection,
    again: Problem,
    told: Selection,
    named: Sequence[int],
    kept: Problem,
    model: Model,
    laws: Sequence[Mapping[str, Any]],
) -> BesideLaw:
    """The same in terms of the problem that has no law in its model."""
    found = told.found
    alone = without_laws(problem, found)
    # a name is as sure as its gain is above what the law's own faults could be
    floor = threshold(again, found.residual, FINAL_SHARE)
    least = {term_of(found.entries[k]): max(floor, unexplained(again, found, k)) for k in named}
    shown = replace(told, null=before.null, part=before.part, found=alone, least=least)
    start = augmented_by(problem, alone, named)
    share, ends = share_removed(Sight(kept, start), kept.residual(model))
    model = names_first(problem, model)
    remainder = Remainder(
        tuple(Term(dict(one), None) for one in laws),
        model,
        share,
        ends,
        problem.residual(start),
        problem.residual(model),
    )
    return BesideLaw(again, told, shown, named, remainder)
