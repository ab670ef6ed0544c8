"""The model of what no name stands for, beside the findings, beside none, or beside a refit.

Names that were found first may be parts of what has none. And where much is unknown, no name is
given to a number of the model's own that is off (a free curve over speed does what a drag does):
such numbers are then fitted beside the remainder, without a name, and a law is looked for only in
what they cannot do (a discrepancy orthogonal to the model's sensitivities: Plumlee, J. Am. Stat.
Assoc. 112, 2017). Recordings kept from the fit choose; where they cannot, fewer curves and maps do.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from eps_hil.diagnosis.accept.by_simulation import refined_by_simulation
from eps_hil.diagnosis.accept.holdout_support import augmented_by
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.attribute.select import Say, Selection
from eps_hil.diagnosis.balance.baseline import ALL, HOLD, OFFSET
from eps_hil.diagnosis.balance.fit import Fit, fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.remainder.find import (
    LEAST_LOWER,
    Floats,
    Remainder,
    find,
    share_removed,
)
from eps_hil.diagnosis.remainder.sight import Sight
from eps_hil.physics.model import Model

_MORE = 0.04
"""Share of the excess by which refitted numbers have to be better than those of the model file."""


def nameless(
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    judged: Sequence[Holdout],
    tied: Mapping[str, float],
    say: Say | None = None,
) -> tuple[Remainder | None, Sequence[int]]:
    """A model of what no name stands for, and the findings that go with it.

    ``tied``: numbers that stand for a load that nobody measured; nothing is refitted beside one.
    """
    found, named = _modelled(problem, selection, findings, judged, tied, say)
    if found is None or tied:
        return found, named
    return simulated_too(problem, selection, named, found, judged), named


def simulated_too(
    problem: Problem,
    selection: Selection,
    named: Sequence[int],
    found: Remainder,
    judged: Sequence[Holdout],
) -> Remainder:
    """The same with its sizes refined by simulation, where hold-outs confirm that."""
    model = refined_by_simulation(problem, found.model, judged, own=found.refitted)
    if model is found.model:
        return found
    start = augmented_by(problem, selection.found, named)
    kept = problem.over([one.prepared for one in judged])
    share, ends = share_removed(Sight(kept, start), kept.residual(model))
    places = [found.model.effects.index(entry) for entry in found.entries]
    terms = [
        replace(term, entry=dict(model.effects[k]))
        for k, term in zip(places, found.terms, strict=True)
    ]
    after = problem.residual(model)
    return replace(found, terms=tuple(terms), model=model, share=share, ci95=ends, after=after)


def _modelled(
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    judged: Sequence[Holdout],
    tied: Mapping[str, float],
    say: Say | None,
) -> tuple[Remainder | None, Sequence[int]]:
    """The same by the torque balance alone."""
    kept = problem.apart([one.prepared for one in judged])
    part = (lambda done: say("modelling what has no name", done)) if say else None
    given = augmented_by(problem, selection.found, findings, tied)

    def beside(model: Model, jacobian: Floats, free: Sequence[str] = ()) -> Remainder | None:
        return find(problem, kept, model, jacobian, part, free)

    def energy(model: Model) -> float:
        return float(np.sum(kept.residual(model)[kept.sliding] ** 2))

    best, named = beside(given, sensitivities(selection.found, findings)), list(findings)
    if findings:
        alone = beside(problem.model, sensitivities(selection.found, []))
        after = given if best is None else best.model
        if alone is not None and energy(alone.model) < energy(after):
            best, named = alone, []
    if tied or (best is not None and best.share > 1.0 - _MORE):
        return best, named
    start = augmented_by(problem, selection.found, named)
    bare = Sight(kept, start)
    refitted = _refitted(problem, selection, named)
    moving = [name for name in movable() if name != HOLD]
    again: Remainder | None = None
    for free in ((), moving):  # beside the refit as it stands, then together with it
        one = beside(*refitted, free)
        if one is None:
            continue
        one = replace(one, model=_settled(problem, one.model, kept))
        if again is None or energy(one.model) < energy(again.model):
            again = one
        if share_removed(bare, kept.residual(again.model))[0] > 1.0 - _MORE:
            break
    if again is None:
        return best, named
    before = Sight(kept, start if best is None else best.model)
    if not _in_its_place(best, again, *share_removed(before, kept.residual(again.model))):
        return best, named
    share, ends = share_removed(bare, kept.residual(again.model))
    return replace(
        again,
        share=share,
        ci95=ends,
        before=problem.residual(start),
        after=problem.residual(again.model),
        refitted=True,
    ), named


def _in_its_place(
    best: Remainder | None, again: Remainder, gone: float, ends: tuple[float, float]
) -> bool:
    """Whether refitted numbers stand: by what they take off more, or for fewer curves and maps."""

    def drawn(found: Remainder | None) -> int:
        return 0 if found is None else sum(term.law is None for term in found.terms)

    better, worse = gone >= _MORE and ends[0] >= LEAST_LOWER, ends[1] < 0.0
    return better or (not worse and drawn(again) < drawn(best))


def sensitivities(found: Fit, findings: Sequence[int]) -> Floats:
    """Sensitivities to the model's own numbers and to those of the findings: none refused."""
    own = len(found.own)
    named = [own + i for i, (k, _) in enumerate(found.names) if k in findings]
    return np.asarray(found.jacobian[:, [*range(own), *named]])


def _refitted(
    problem: Problem, selection: Selection, findings: Sequence[int]
) -> tuple[Model, Floats]:
    """The model with its own numbers fitted beside the findings, and all their sensitivities.

    Without a constant torque, which would be an effect that nobody names: the levels of both
    directions are free.
    """
    found = selection.found
    entries = [found.entries[k] for k in findings]
    own = {**ALL, **{name: value for name, value in found.own.items() if name in ALL}}
    own.pop(OFFSET)
    if any(entry["effect"] == HOLD for entry in entries):
        own.pop(HOLD)
    free = fit(problem, entries, own=own)
    model = augmented_by(problem, free, range(len(free.entries)), moved=True)
    return model, free.jacobian


def movable() -> list[str]:
    """Numbers of the model's own beside a law; of the others sliding says nothing more."""
    done = {"sigma0_nm_per_rad", "sigma1_nm_s_per_rad", OFFSET}
    return [name for name in ALL if name not in done]


def _settled(problem: Problem, model: Model, kept: Problem) -> Model:
    """The model's own numbers once more, now beside the laws, where hold-outs agree."""
    beside = replace(problem, model=model)
    own = dict.fromkeys(movable(), 0.0)
    free = fit(beside, [], own=own)
    moved = augmented_by(beside, free, (), moved=True)
    before, after = (np.sum(kept.residual(one)[kept.sliding] ** 2) for one in (model, moved))
    return moved if after < before else model
