"""Names beside a whole model of what has no name: those that it left, and those that it holds.

Terms are looked for one after the other, and what shares its work with a number of the model's own
is found only with such numbers free. What such a model leaves may be an effect: it stood in no
search before, as nothing shows beside a law that is not there yet. And its last term may be one: a
law of the same form was as good as the name. So names are searched for once more beside all terms.
Then each law in turn is taken out, and the effects are asked beside the others, their numbers free;
one that takes as much off hold-outs stands in its place, if it gains more than what stays
unexplained where it acts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from eps_hil.diagnosis.accept.as_name import AS_GOOD, inside
from eps_hil.diagnosis.accept.beside_law import (
    BesideLaw,
    beside_laws,
    names_beside,
    outweighing,
    unexplained,
)
from eps_hil.diagnosis.accept.holdout_support import augmented_by
from eps_hil.diagnosis.accept.measured_ratio import no_name
from eps_hil.diagnosis.accept.nameless import movable
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.accept.standing import standing
from eps_hil.diagnosis.attribute.scoring import (
    FINAL_SHARE,
    Scored,
    is_curve,
    score,
    threshold,
)
from eps_hil.diagnosis.attribute.select import Selection, rivals_of
from eps_hil.diagnosis.balance.baseline import HOLD, SIDES, TIMING, law_knobs
from eps_hil.diagnosis.balance.fit import Fit, fit, matters
from eps_hil.diagnosis.balance.probes import Candidate, candidates
from eps_hil.diagnosis.balance.problem import Problem, term_of
from eps_hil.diagnosis.mismatch.curve import with_curve
from eps_hil.diagnosis.mismatch.leftover import BESIDE_UNKNOWN, leftover
from eps_hil.diagnosis.remainder.find import MOST_OF_IT, Remainder, share_removed
from eps_hil.diagnosis.remainder.sight import Sight
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model

_LEARNT = "empirical"
_MOST = 4
"""Effects that are fitted in the place of one law."""


@dataclass(frozen=True)
class _Named:
    """A fit of names beside the laws that are left, and the share that the new name takes off."""

    weighed: Problem
    found: Fit
    pool: Sequence[Candidate]
    written: Model
    share: float


def named_terms(
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    remainder: Remainder,
    judged: Sequence[Holdout],
    *,
    measured: bool,
) -> BesideLaw | None:
    """The same with more names, or with names in the place of laws but the last; None without.

    ``selection`` and ``findings`` are of ``problem``, which has no laws in its model. ``measured``:
    whether rotor against rack has measured the ratio, which is then no name.
    """
    without = set(catalogue()) - {one.effect.id for one in selection.pool}
    kept = problem.apart([one.prepared for one in judged])
    best = _left_by_all(problem, selection, findings, remainder, judged, kept, measured)
    while len((best.remainder if best else remainder).terms) > 1:
        terms = best.remainder if best else remainder
        one = _one_named(problem, terms, kept, without | no_name(measured))
        if one is None:
            break
        told = replace(
            selection, found=one.found, searched=one.found, part=one.weighed,
            pool=list(one.pool), rivals={}, gains={}, without={},
        )  # fmt: skip
        rivals_of(one.weighed, told)
        places = list(range(len(one.found.entries)))
        least = max(
            threshold(one.weighed, one.found.residual, FINAL_SHARE),
            unexplained(one.weighed, one.found, places[-1]) / BESIDE_UNKNOWN,
        )
        new = told.gains.get(term_of(one.found.entries[-1]), 0.0)
        if new < least or standing(one.weighed, told, places, judged) != places:
            break
        best = _found(problem, selection, one.weighed, told, places, kept, one.written, remainder)
    return best


def _left_by_all(
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    remainder: Remainder,
    judged: Sequence[Holdout],
    kept: Problem,
    measured: bool,
) -> BesideLaw | None:
    """More names beside all terms, where those leave more than noise, or took a delay along."""
    model = remainder.model
    delay_s = problem.model.delays_s.motor_torque - model.delays_s.motor_torque
    late = matters({"effect": HOLD, "delay_s": delay_s}, problem)
    left = leftover(problem, problem.residual(model), (kept, kept.residual(model)))
    if left is None and not late:
        return None
    laws = [one for one in _beyond(problem, model) if one["effect"] == _LEARNT]
    again = _with_laws(problem, model, laws)
    without = set(catalogue()) - {one.effect.id for one in selection.pool}
    told, named = names_beside(again, selection, without, judged, measured=measured)
    named = outweighing(again, told, named, kept)
    before = {term_of(selection.found.entries[k]) for k in findings}
    if not before < {term_of(told.found.entries[k]) for k in named}:
        return None
    written = augmented_by(again, told.found, named, moved=True)
    return _found(problem, selection, again, told, named, kept, written, remainder)


def _with_laws(problem: Problem, model: Model, laws: Sequence[Mapping[str, Any]]) -> Problem:
    """The problem with the model's own numbers, and laws in it whose numbers are free.

    How late the motor's torque is, is as in the file: a fit beside laws may have moved a delay
    there that has a name.
    """
    timing = problem.model.delays_s
    given = replace(model, effects=(*problem.model.effects, *laws), delays_s=timing)
    again = replace(problem.apart(problem.recordings), model=given)
    again.tied = law_knobs(given, len(problem.model.effects))
    return again


def _found(
    problem: Problem,
    selection: Selection,
    weighed: Problem,
    told: Selection,
    places: Sequence[int],
    kept: Problem,
    written: Model,
    before: Remainder,
) -> BesideLaw:
    laws = [entry for entry in _beyond(problem, written) if entry["effect"] == _LEARNT]
    found = beside_laws(problem, selection, weighed, told, places, kept, written, laws)
    return replace(found, remainder=replace(found.remainder, refitted=before.refitted))


def _beyond(problem: Problem, model: Model) -> Sequence[Mapping[str, Any]]:
    """Entries that a model has and the given one has not."""
    return model.effects[len(problem.model.effects) :]


def _one_named(
    problem: Problem, remainder: Remainder, kept: Problem, without: set[str]
) -> _Named | None:
    """The name that takes most off in the place of a law, of those that take as much."""
    model = remainder.model
    there = _beyond(problem, model)
    names = [dict(one) for one in there if one["effect"] != _LEARNT]
    laws = [one for one in there if one["effect"] == _LEARNT]
    best: _Named | None = None
    for k, law in enumerate(laws):
        if "values" in law:
            continue
        others = [*laws[:k], *laws[k + 1 :]]
        bare = Sight(kept, replace(model, effects=(*problem.model.effects, *names, *others)))
        by_law = share_removed(bare, kept.residual(model, bare.model))[0]
        if by_law < MOST_OF_IT:
            continue
        again = _with_laws(problem, model, others)
        moved = dict.fromkeys(movable(), 0.0) if remainder.refitted else {}  # as the laws were
        own = {**TIMING, **again.tied, **moved}
        if any(one["effect"] == HOLD for one in names):
            own.pop(HOLD)
        base = fit(again, names, own=own)
        pool = candidates(again, base.entries, base.residual, None, base.own, without)
        for one in _worth_a_fit(score(again, base, pool)):
            trial = _fitted(again, base, one)
            if trial is None:
                continue
            written = augmented_by(again, trial, range(len(trial.entries)), moved=True)
            share = share_removed(bare, kept.residual(written, bare.model))[0]
            if share > max(AS_GOOD * by_law, best.share if best else 0.0):
                best = _Named(again, trial, pool, written, share)
    return best


def _worth_a_fit(scored: Sequence[Scored]) -> Sequence[Scored]:
    """The best shape of each effect, the best effects first."""
    of: dict[str, Scored] = {}
    for one in scored:
        of.setdefault(one.candidate.effect.id, one)
    return list(of.values())[:_MOST]


def _fitted(problem: Problem, base: Fit, one: Scored) -> Fit | None:
    """With one effect more; None where that is too small, or at the bound of what it can be."""
    name = str(one.entry["effect"])
    own = dict(base.own) | {side: 0.0 for side in SIDES.get(name, ()) if side != HOLD}
    if name == HOLD:
        own.pop(HOLD, None)
    if is_curve(one.candidate):
        found = with_curve(problem, base)
    else:
        found = fit(problem, [*base.entries, one.entry], own=own)
    entry = found.entries[-1] if len(found.entries) > len(base.entries) else {}
    return found if entry and matters(entry, problem) and inside(entry, problem) else None
