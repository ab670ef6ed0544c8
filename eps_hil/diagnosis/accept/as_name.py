"""A law that is nothing but a number of the model's own that is off, by the name of that number.

Beside much that is unknown, a name is weighed against a free discrepancy, which holds whatever a
friction level does. A law of few numbers is not, and may then say the same in other words: a torque
that saturates with the speed, or soon after a reversal, is a friction level. Where a law explains
most of recordings that were kept from the fit, and one such name does as well, that stands in its
place.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eps_hil.diagnosis.accept.holdout_support import augmented_by
from eps_hil.diagnosis.accept.nameless import sensitivities
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.accept.standing import standing
from eps_hil.diagnosis.attribute.numbers import SPANNED
from eps_hil.diagnosis.attribute.select import Selection, rivals_of
from eps_hil.diagnosis.balance.baseline import HOLD, TIMING
from eps_hil.diagnosis.balance.fit import Fit, fit, matters
from eps_hil.diagnosis.balance.probes import bounds, probe_step
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.remainder.find import MOST_OF_IT, Remainder, find, share_removed
from eps_hil.diagnosis.remainder.sight import Sight
from eps_hil.physics.effects.catalogue import catalogue

AS_GOOD = 0.97
"""Of the share of the hold-outs' excess that a law takes off: a name that takes as much says it."""
_START = 0.02
"""Of an effect's small change: where a fit begins that knows nothing."""


def as_name(
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    law: Remainder,
    judged: Sequence[Holdout],
    tied: Mapping[str, float],
) -> tuple[Selection, Sequence[int], Remainder | None] | None:
    """A selection with the name of a number in the place of ``law``, the places of the findings
    there, and what still has no name beside them; None where no name does as well.
    """
    if selection.part is not problem:
        return None
    kept = problem.apart([one.prepared for one in judged])
    there = Sight(kept, problem.model)
    entries = [selection.found.entries[k] for k in findings]
    named = {str(one["effect"]) for one in entries}
    least = AS_GOOD * share_removed(there, kept.residual(law.model, problem.model))[0]
    if least < MOST_OF_IT:
        return None
    best: Fit | None = None
    candidates = {one.effect.id: one for one in selection.pool if one.effect.id in SPANNED}
    for name, candidate in candidates.items():
        if name in named:
            continue
        start = candidate.entry(np.array([_START * probe_step(candidate.effect, problem)]), problem)
        own = {key: value for key, value in TIMING.items() if HOLD not in (*named, name)}
        trial = fit(problem, [*entries, start], own={**own, **tied})
        if not all(matters(one, problem) and inside(one, problem) for one in trial.entries):
            continue
        written = augmented_by(problem, trial, range(len(trial.entries)))
        share = share_removed(there, kept.residual(written, problem.model))[0]
        if share > least:
            best, least = trial, share
    if best is None:
        return None
    told = replace(selection, found=best, searched=best, rivals={}, gains={}, without={})
    rivals_of(problem, told)
    places = list(range(len(best.entries)))
    if standing(problem, told, places, judged) != places:
        return None
    beside = augmented_by(problem, best, places, tied)
    return told, places, find(problem, kept, beside, sensitivities(best, places))


def inside(entry: Mapping[str, Any], problem: Problem) -> bool:
    """Whether no number of an entry ended at the bound of what it can be."""
    effect = catalogue()[str(entry["effect"])]
    at = [one for one in effect.parameters if one.name in entry]
    return all(entry[one.name] not in bounds(effect, one, problem) for one in at)
