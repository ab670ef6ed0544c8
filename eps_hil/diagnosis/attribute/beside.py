"""Names beside what stays unknown: a stepwise search by evidence with an estimated discrepancy.

Where the ordinary search leaves more than noise, its gates (which compare with all that is left)
say nothing any more. Here each model, a set of names, is worth its log evidence beside a
discrepancy of its own (``balance/discrepancy.py``). A name is added or kept where that gains
:data:`LEAST` nats, for independent observations, beyond the price of its numbers.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.attribute.numbers import CONSTANTS, SCALES, SPANNED
from eps_hil.diagnosis.attribute.scoring import (
    IN_CURVE,
    is_curve,
    refitted,
)
from eps_hil.diagnosis.attribute.select import Selection, rivals_of
from eps_hil.diagnosis.balance.baseline import ALL, HOLD, SIDES, TIMING, is_free
from eps_hil.diagnosis.balance.discrepancy import Discrepancy, Evidence
from eps_hil.diagnosis.balance.fit import Fit, deviation, fit, own_column
from eps_hil.diagnosis.balance.probes import Candidate, orders_of, taken_anew
from eps_hil.diagnosis.balance.problem import Problem, knee, term_of
from eps_hil.diagnosis.balance.reference import OF_MOTOR, torque_is_referenced
from eps_hil.diagnosis.mismatch.curve import ID as CURVE

Floats = npt.NDArray[np.float64]
Entries = Sequence[Mapping[str, Any]]

LEAST = 15.0
"""Gain of log evidence (nats) that counts: half of 30 noise variances, as everywhere."""
_MOST_STEPS = 8
_BEST_SHAPES = 2


@dataclass(frozen=True)
class Beside:
    """The problem whitened by what stays unknown, the fit of the names there, and their gains."""

    problem: Problem
    found: Fit
    gains: Mapping[str, float]
    """By term: twice the gain of log evidence, which is in noise variances."""
    pool: Sequence[Candidate]
    """Sensitivities as they were taken there, not whitened."""


@dataclass(frozen=True)
class _Model:
    """A set of names: residual and sensitivities not whitened, and its evidence."""

    entries: Entries
    at: Fit
    evidence: Evidence
    gains: Mapping[str, float]


def beside(problem: Problem, found: Fit, pool: Sequence[Candidate]) -> Beside:
    """Names that the recordings show beside a discrepancy; ``found``: what was found without."""
    search = _Search(problem, found)
    pool = search.weighed(search.discrepancy.evidence(found.residual, found.jacobian), pool)
    structures = [entry for entry in found.entries if entry["effect"] not in SPANNED]
    search.own = {**ALL, **problem.tied}
    model = search.settled(structures, search.with_orders(structures, pool))
    pool = search.weighed(model.evidence, pool)
    numbers = [entry for entry in found.entries if entry["effect"] in SPANNED]
    search.own = {**TIMING, **problem.tied}
    spanned = [c for c in pool if c.effect.id in SPANNED]
    model = search.settled([*model.entries, *numbers], spanned)
    whitened = search.whitened(model.evidence)
    again = fit(whitened, model.entries, own=model.at.own)
    return Beside(whitened, again, model.gains, pool)


def selected_beside(selection: Selection) -> tuple[Problem, Selection]:
    """The whitened problem, and a selection of what is found there, fitted to what was searched."""
    searched, pool = selection.searched, selection.pool
    if not torque_is_referenced(selection.part):
        pool = [one for one in pool if one.effect.id not in OF_MOTOR]
        entries = [one for one in searched.entries if one["effect"] not in OF_MOTOR]
        if len(entries) < len(searched.entries):
            searched = fit(selection.part, entries, own=searched.own)
    told = beside(selection.part, searched, pool)
    problem, found = told.problem, told.found
    pool = [replace(one, columns=problem.whitened(one.columns)) for one in told.pool]
    null = fit(problem, [], own={**TIMING, **problem.tied})
    again = replace(
        selection, null=null, found=found, searched=found, part=problem, pool=pool,
        rivals={}, gains={}, without={},
    )  # fmt: skip
    rivals_of(problem, again)
    again.gains = {term: told.gains[term] for term in again.gains}
    return problem, again


def not_whitened(problem: Problem, told: Selection, before: Selection) -> Selection:
    """What was ``told`` beside a remainder, with residuals of all of ``problem``, not whitened.

    What is said of places and sizes is said of those; intervals and gains stay as they were told.
    ``before``: the selection that knew of no remainder.
    """
    found = told.found
    shown = problem.residual(problem.with_entries(found.entries, found.own))
    return replace(
        told,
        null=before.null,
        part=before.part,
        found=replace(found, residual=shown, told_half_width=found.half_width),
        least=dict.fromkeys(told.gains, 2.0 * LEAST),
    )


class _Search:
    """Forward and backward steps over sets of names."""

    def __init__(self, problem: Problem, found: Fit) -> None:
        self.problem = problem
        self.problem.knee = knee(found.residual)
        self.discrepancy = Discrepancy(problem, found.residual)
        self.price = 0.5 * float(np.log(max(problem.independent, 2.0)))
        self.own: Mapping[str, float] = {}
        self.refused: set[str] = set()

    def weighed(self, evidence: Evidence, pool: Sequence[Candidate]) -> Sequence[Candidate]:
        """From here on, what is left beside the discrepancy weighs as much under every model.

        Returns the pool; what changes the noise that is expected, by sensitivities taken anew.
        """
        before, self.problem = self.problem, self.problem.beside_sigma(evidence.sigma)
        if self.problem is before:
            return pool
        return taken_anew(self.problem, pool)

    def with_orders(self, entries: Entries, pool: Sequence[Candidate]) -> list[Candidate]:
        """Structures of the pool; what repeats with the angle, at the orders beside the unknown.

        A periodogram of all that is left has the unknown's peaks, and a ripple at their skirts.
        """
        pool = [one for one in pool if one.effect.id not in SPANNED]
        repeating = {one.effect.id: one.effect for one in pool if one.repeats}
        if not repeating:
            return pool
        bare = [e for e in entries if e["effect"] not in repeating]
        model = self.model(bare)
        whitened = self.whitened(model.evidence)
        left = whitened.whitened(refitted(model.at.residual, model.at.jacobian))
        base = (model.entries, model.at.own)
        new = orders_of(self.problem, base, model.at.residual, left, list(repeating.values()))
        return [*(one for one in pool if not one.repeats), *new]

    def settled(self, entries: Entries, pool: Sequence[Candidate]) -> _Model:
        """The best set of names that steps lead to."""
        model = self.backward(self.model(entries))
        for _ in range(_MOST_STEPS):
            trial = self.forward(model, pool)
            if trial is None:
                return model
            better = self.backward(trial)
            if {term_of(e) for e in better.entries} == {term_of(e) for e in model.entries}:
                return better
            model = better
        return model

    def whitened(self, evidence: Evidence) -> Problem:
        """The problem with residuals whitened by what goes with that evidence."""
        whitened = self.problem.beside(self.discrepancy.whitening(evidence))
        whitened.knee, whitened.at = self.problem.knee, self.problem.at
        whitened.columns = {
            name: whitened.whitened(own_column(self.problem, name)) for name in self.own
        }
        return whitened

    def _own(self, entries: Entries) -> dict[str, float]:
        own = dict(self.own)
        names = {str(entry["effect"]) for entry in entries}
        if not is_free(own):
            own |= {side: 0.0 for name in names for side in SIDES.get(name, ())}
        if HOLD in names:
            own.pop(HOLD, None)
        return own

    def model(self, entries: Entries, like: Evidence | None = None) -> _Model:
        """The names fitted beside a discrepancy; gains are not known yet."""
        at = fit(self.problem, entries, 0, self._own(entries))
        evidence = self.discrepancy.evidence(at.residual, at.jacobian, like)
        again = fit(self.whitened(evidence), entries, own=at.own)
        kept = [e for e in again.entries if deviation(e, self.problem) > 1e-9]
        at = fit(self.problem, kept, 0, self._own(kept) if len(kept) < len(entries) else again.own)
        return _Model(kept, at, self.discrepancy.evidence(at.residual, at.jacobian, evidence), {})

    def backward(self, model: _Model) -> _Model:
        """Without the names that evidence does not ask for, one at a time."""
        while True:
            gains = [self.gain(model, k) for k in range(len(model.entries))]
            if not gains or min(gains) >= LEAST:
                told = {
                    term_of(e): 2.0 * gain for e, gain in zip(model.entries, gains, strict=True)
                }
                return replace(model, gains=told)
            weakest = int(np.argmin(gains))
            self.refused.add(term_of(model.entries[weakest]))
            left = [e for k, e in enumerate(model.entries) if k != weakest]
            model = self.model(left, model.evidence)

    def gain(self, model: _Model, k: int) -> float:
        """What entry ``k`` is worth (nats, for independent observations)."""
        others = [e for i, e in enumerate(model.entries) if i != k]
        first = len(model.at.own)
        its = [first + i for i, (place, _) in enumerate(model.at.names) if place == k]
        jacobian = np.delete(model.at.jacobian, its, axis=1)
        without = self.problem.residual(self.problem.with_entries(others, model.at.own))
        found = max(
            self.discrepancy.evidence(without, jacobian, like).log
            for like in (None, model.evidence)
        )
        numbers = len(its) + len(model.entries[k].get("curve", ()))
        columns = model.at.jacobian[:, its]
        effect = 1.0
        if its:
            effect = self.discrepancy.design_effect(
                model.at.residual, jacobian, columns, model.evidence
            )
        return (model.evidence.log - found - numbers * self.price) / effect

    def forward(self, model: _Model, pool: Sequence[Candidate]) -> _Model | None:
        """The model with the one name more that gains most; None if none gains enough."""
        best, chosen = LEAST, None
        for one in self._worth_a_look(model, pool):
            beside = np.hstack([model.at.jacobian, one.columns])
            found = self.discrepancy.evidence(model.at.residual, beside, model.evidence)
            gain = found.log - model.evidence.log - one.columns.shape[1] * self.price
            if gain <= best:
                continue
            gain /= self.discrepancy.design_effect(
                model.at.residual, model.at.jacobian, one.columns, found
            )
            entry = self._start(model, one)
            if gain > best and deviation(entry, self.problem) > 0.0:  # else it is not this effect
                best, chosen = gain, entry
        if chosen is None:
            return None
        return self.model([*model.entries, chosen], model.evidence)

    def _start(self, model: _Model, one: Candidate) -> dict[str, Any]:
        """The candidate's entry with what one linear step makes of its numbers."""
        left = refitted(model.at.residual, model.at.jacobian)
        columns = _orthogonal(one.columns, model.at.jacobian)
        start = np.asarray(np.linalg.lstsq(columns, left, rcond=1e-12)[0], dtype=np.float64)
        return one.entry(start, self.problem)

    def _worth_a_look(self, model: _Model, pool: Sequence[Candidate]) -> Iterable[Candidate]:
        """Of each effect the shapes that gain most beside the model's own discrepancy."""
        there = {str(entry["effect"]) for entry in model.entries}
        taken = set(IN_CURVE) if CURVE in there else set()
        taken |= set(CONSTANTS) if there & set(CONSTANTS) else set()
        taken |= set(SCALES) if there & set(SCALES) else set()
        whitened = self.whitened(model.evidence)
        jacobian = whitened.whitened(model.at.jacobian)
        left = refitted(whitened.whitened(model.at.residual), jacobian)
        ranked: dict[str, list[tuple[float, int]]] = {}
        for k, one in enumerate(pool):
            refused = one.effect.id in self.refused and not one.repeats
            if is_curve(one) or refused or one.effect.id in taken:
                continue
            if not one.beside(model.entries, self.problem.model, self.problem.size.angle):
                continue
            columns = _orthogonal(whitened.whitened(one.columns), jacobian)
            slope = columns.T @ left
            gain = float(slope @ np.linalg.pinv(columns.T @ columns, hermitian=True) @ slope)
            ranked.setdefault(one.effect.id, []).append((gain, k))
        for shapes in ranked.values():
            yield from (pool[k] for _, k in sorted(shapes, reverse=True)[:_BEST_SHAPES])


def _orthogonal(columns: Floats, others: Floats) -> Floats:
    size = np.sqrt(np.sum(others**2, axis=0))
    others = others[:, size > 0.0] / size[size > 0.0]
    if not others.shape[1]:
        return columns
    return np.asarray(columns - others @ np.linalg.lstsq(others, columns, rcond=1e-9)[0])
