"""Fewer names, or better ones, in the place of those that were found one at a time."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from eps_hil.diagnosis.attribute.scoring import (
    FORWARD_SHARE,
    IN_CURVE,
    LEAST_GAIN,
    NEAR,
    Scored,
    is_curve,
    penalised,
    score,
    threshold,
)
from eps_hil.diagnosis.balance.fit import Fit, ablated, fit, own_without
from eps_hil.diagnosis.balance.probes import Candidate
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee
from eps_hil.diagnosis.mismatch.curve import ID as CURVE

_ROUGHLY = 0.9
"""A linear step tells what a pair is worth to within this."""


def exchanged(problem: Problem, found: Fit, pool: Sequence[Candidate]) -> Fit:
    """One effect in the place of two, where it does as well: fewer names explain as much."""
    changed = True
    while changed and len(found.entries) > 1:
        changed = False
        least = threshold(problem, found.residual, FORWARD_SHARE)
        for pair in combinations(range(len(found.entries)), 2):
            without = _roughly_without(problem, found, pair)
            loss = without.cost - found.cost
            best = score(problem, without, pool)[:1]
            if not best or best[0].gain < _ROUGHLY * NEAR * loss:
                continue
            trial = fit(problem, [*without.entries, best[0].entry], own=without.own, like=without)
            if trial.cost < found.cost + least:
                found, changed = trial, True
                break
    return found


def _roughly_without(problem: Problem, found: Fit, places: Collection[int]) -> Fit:
    """The fit without some entries, the others refitted in one linear step."""
    left = [i for i in range(len(found.entries)) if i not in places]
    entries = [found.entries[i] for i in left]
    own = own_without(found, places)
    residual = problem.residual(problem.with_entries(entries, own))
    keep = [i for i, (k, _) in enumerate(found.names) if k in left]
    columns = [i for i, name in enumerate(found.own) if name in own]
    jacobian = found.jacobian[:, [*columns, *(len(found.own) + i for i in keep)]]
    cut = clipped(residual, knee(residual))
    size = np.sqrt(np.sum(jacobian**2, axis=0)) + 1e-300
    step = np.linalg.lstsq(
        (jacobian / size).T @ (jacobian / size), (jacobian / size).T @ cut, rcond=1e-9
    )[0]
    residual = residual - (jacobian / size) @ step
    return replace(
        found,
        entries=tuple(entries),
        residual=residual,
        names=tuple((left.index(found.names[i][0]), found.names[i][1]) for i in keep),
        jacobian=jacobian,
        own=own,
        cost=problem.cost(residual),
        noise={(left.index(k), name): one for (k, name), one in found.noise.items() if k in left},
    )


def _in_place_of(gone: str, scored: Sequence[Scored], least: float) -> Iterator[Scored]:
    """What is worth a fit in the place of an effect: of the best, what gains about as much.

    What a curve holds already is fitted anyhow, from its best shape: a stop that is touched by a
    millimetre begins between two positions of the grid, where it seems to gain little.
    """
    for one in scored[:3]:
        if one.gain >= least and one.candidate.effect.id != gone and not is_curve(one.candidate):
            yield one
    for name in IN_CURVE if gone == CURVE else ():
        yield from [one for one in scored if one.candidate.effect.id == name][:1]


def bettered(problem: Problem, found: Fit, pool: Sequence[Candidate]) -> Fit:
    """One effect in the place of another, where it does clearly better with no more numbers."""
    k = 0
    while k < len(found.entries):
        without = ablated(problem, found, k)
        loss, before = without.cost - found.cost, found
        gone = found.entries[k]["effect"]
        for one in _in_place_of(gone, score(problem, without, pool), NEAR * loss):
            trial = fit(problem, [*without.entries, one.entry], own=without.own, like=without)
            if penalised(trial) < penalised(found) - LEAST_GAIN:
                found = trial
                break
        k = 0 if found is not before else k + 1
    return found
