"""Baseline and missing physics of the axis together, from the free recording alone.

The sensors of this axis are far better than any law of friction: 0.03 N of noise under 1 N that no
smooth law follows. So a diagnosis is told of that 1 N as the noise of the motor's force (it is the
typical residual of the identified structure, measured here), and everything is judged against it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eps_hil.axis.emps import ARM_M, AxisRecord
from eps_hil.axis.identify import identify
from eps_hil.diagnosis.attribute.select import select
from eps_hil.diagnosis.balance.fit import Fit, fit
from eps_hil.diagnosis.balance.problem import Problem, plain
from eps_hil.diagnosis.data.prepare import CUTOFF_HZ, STEP_S, Prepared, prepare
from eps_hil.physics.model import Model
from eps_hil.series import Series

FITTED_PART = 2 / 3
"""Share of the free recording that effects are chosen on; the rest judges them."""
LEAST_LOSS = 0.05
"""An effect stays if the judging part's residual energy rises by this share without it, though the
model's own numbers and the other effects are fitted anew to make up for it."""
_ROUNDS = 2

TIMING = {"effect": "motor_torque_delay", "delay_s": 0.0}

NOT_FROM_FREE_RUNS = (
    "motor_torque_gain",
    "motor_torque_saturation",
    "rack_ratio",
    "position_torque",
    "position_dependent_friction",
    "unmodelled_spring",
    "end_stop",
)
"""Not to be known from one recording without any load. No force is known there, so how the motor's
scale varies shows only against mass and friction, which are not known either; and one programme
passes each place at the same speeds, so that a shape over place takes what belongs to speed."""

Say = Callable[[str, float], None]
Entries = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Augmented:
    """Identified model, model with effects, their fit, what each is worth on the judging part."""

    identified: Model
    model: Model
    fit: Fit
    losses: Sequence[float]
    noise_n: float


def augment(record: AxisRecord, published: Model, say: Say | None = None) -> Augmented:
    """Identify, find effects on two thirds, judge them on the rest, fit all on the whole."""
    whole = prepare(record.name, record.series(free_of_load=True))
    cut = round(len(record.force_n) * FITTED_PART)
    fitted = prepare(record.name, _part(record, slice(None, cut)))
    judged = prepare(record.name, _part(record, slice(cut, None)))
    nominal = identify(fitted, published)
    noise = _typical_residual_nm(fitted, nominal)
    fitted, judged, whole = (_noisy(one, noise) for one in (fitted, judged, whole))
    found = select(_problem(fitted, nominal), say, NOT_FROM_FREE_RUNS)
    entries: Entries = found.found.entries
    if all(entry["effect"] != TIMING["effect"] for entry in entries):
        entries = (TIMING, *entries)
    model, entries, losses = _pruned(fitted, judged, nominal, entries, say)
    model, last = _refitted(whole, model, entries)
    augmented = _with(model, last.entries)
    return Augmented(identify(whole, published), augmented, last, losses, noise / ARM_M)


def _problem(prepared: Prepared, model: Model) -> Problem:
    """A friction that bends the other way than its name says is wanted too: the shape predicts."""
    return Problem([prepared], model, either_sign=True)


def _with(model: Model, entries: Entries) -> Model:
    return replace(model, effects=tuple(plain(entry) for entry in entries))


def _part(record: AxisRecord, part: slice) -> Mapping[str, Series]:
    return {
        name: Series(one.t_ns[part], one.value[part])
        for name, one in record.series(free_of_load=True).items()
    }


def _typical_residual_nm(prepared: Prepared, model: Model) -> float:
    """Standard deviation by the median, with the best skew of the motor's force taken out."""
    timed = fit(_problem(prepared, model), [TIMING])
    left = prepared.residual(_with(model, timed.entries))[0]
    return float(np.median(np.abs(left)) / 0.6745)


def _noisy(prepared: Prepared, floor_nm: float) -> Prepared:
    """The same recording with a motor torque as uncertain as gives that floor in the residual."""
    share = 2 * CUTOFF_HZ * STEP_S  # of white noise that passes the diagnosis' filter
    sigma = floor_nm / float(np.sqrt(share))
    return replace(prepared, noise={**prepared.noise, "motor_torque_nm": sigma})


def _pruned(
    fitted: Prepared, judged: Prepared, model: Model, entries: Entries, say: Say | None
) -> tuple[Model, Entries, Sequence[float]]:
    """Drop the effect that is worth least on the judging part until all are worth something."""
    model, best = _refitted(fitted, model, entries)
    entries = best.entries
    while True:
        energy = _energy(judged, model, entries)
        without = []
        for k in range(len(entries)):
            if say:
                say("judging on what was not fitted", k / len(entries))
            others = [entry for i, entry in enumerate(entries) if i != k]
            less, again = _refitted(fitted, model, others)
            loss = _energy(judged, less, again.entries) / energy - 1.0
            without.append((loss, less, again.entries))
        losses = [loss for loss, _, _ in without]
        if not without or min(losses) >= LEAST_LOSS:
            return model, entries, losses
        _, model, entries = min(without, key=lambda one: one[0])


def _refitted(prepared: Prepared, model: Model, entries: Entries) -> tuple[Model, Fit]:
    """The model's own numbers and the effects' in turn, until both have seen the other."""
    found = fit(_problem(prepared, model), entries)
    for _ in range(_ROUNDS):
        whole = identify(prepared, _with(model, found.entries))
        model = replace(whole, effects=())
        found = fit(_problem(prepared, model), found.entries)
    return model, found


def _energy(prepared: Prepared, model: Model, entries: Entries) -> float:
    residual = prepared.residual(_with(model, entries))[0]
    return float(np.mean(residual**2))
