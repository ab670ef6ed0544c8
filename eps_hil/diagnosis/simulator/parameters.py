"""The model file's own numbers, moved as far as given traces ask for and no further."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.problem import Problem, knee
from eps_hil.identification.bounds import inside
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

WORTH = 12.0
"""A number stays at the model file's value unless moving it gains this many noise variances."""
_NOTHING = 2.0
_UNSEEN = 0.3
"""A relative deviation above which the traces say nothing of a number."""


@dataclass(frozen=True, slots=True)
class Free:
    """One number of the model file: name, unit, a size to count it in, its least value."""

    name: str
    unit: str
    scale: float
    least: float


FREE = (
    Free("inertia_kg_m2", "kg m²", 1e-4, 1e-6),
    Free("offset_pos_nm", "Nm", 0.05, 0.0),
    Free("offset_neg_nm", "Nm", 0.05, 0.0),
    Free("viscous_pos_nm_s_per_rad", "Nm s/rad", 2e-4, 0.0),
    Free("viscous_neg_nm_s_per_rad", "Nm s/rad", 2e-4, 0.0),
    Free("load_pos_nm_per_n", "Nm/N", 4e-5, 0.0),
    Free("load_neg_nm_per_n", "Nm/N", 4e-5, 0.0),
)
_TIMES = ("motor_speed", "motor_torque")
_TIME_SCALE_S = 1e-3
_FAR = 30.0
"""Residuals (in noise deviations) beyond this are drawn in while the model is still far off."""
_STEP = 0.01
"""Of a finite difference, in units of a number's own size."""


@dataclass(frozen=True)
class Reduction:
    """The model that fits, its residual, what was moved (value before, after, deviation)."""

    model: Model
    residual: Floats
    moved: tuple[tuple[Free, float, float, float], ...]
    unseen: tuple[str, ...]

    def content(self) -> dict[str, Any]:
        """For the JSON: each number that the traces move, beside the model file's."""
        return {
            one.name: {
                "value": after,
                "model_file": before,
                "unit": one.unit,
                "ci95": [after - 1.96 * sigma, after + 1.96 * sigma],
            }
            for one, before, after, sigma in self.moved
        }


def reduce_parameters(problem: Problem, *, timing: bool = True) -> Reduction:
    """Least squares over inertia, friction and timing, then back to the file's value one by one.

    The prior keeps what the traces do not show: each number's own size is its deviation.
    """
    nominal = problem.model
    start = _start(nominal)
    free = list(range(len(start) if timing else len(FREE)))
    found, cost, sigma = _fit(problem, start, start, free, _FAR, 5)
    at = knee(problem.residual(_moved(nominal, found)))
    found, cost, sigma = _fit(problem, start, found, free, at, 5)
    unseen = tuple(
        one.name for k, one in enumerate(FREE) if sigma[k] > _UNSEEN * max(abs(found[k]), 0.1)
    )
    while free:
        # what moving a number gains once the others are fitted again (Wald)
        gains = {k: ((found[k] - start[k]) / max(sigma[k], 1e-12)) ** 2 for k in free}
        weak = [k for k in free if gains[k] < _NOTHING] or [min(gains, key=lambda k: gains[k])]
        rest = [k for k in free if k not in weak]
        back = found.copy()
        back[weak] = start[weak]
        trial, higher, deviation = _fit(problem, start, back, rest, at, 3)
        if higher - cost > WORTH * len(weak):
            break
        free, found, cost, sigma = rest, trial, higher, deviation
    moved = tuple(
        (one, _value(nominal, one), float(found[k] * one.scale), float(sigma[k] * one.scale))
        for k, one in enumerate(FREE)
        if k in free
    )
    model = _moved(nominal, found)
    return Reduction(model, problem.residual(model), moved, unseen)


def _start(model: Model) -> Floats:
    return np.array([_value(model, one) / one.scale for one in FREE] + [0.0] * len(_TIMES))


def _value(model: Model, one: Free) -> float:
    return float(
        model.inertia_kg_m2 if one.name == "inertia_kg_m2" else getattr(model.friction, one.name)
    )


def _moved(model: Model, values: Floats) -> Model:
    numbers = {one.name: float(v * one.scale) for one, v in zip(FREE, values, strict=False)}
    inertia = numbers.pop("inertia_kg_m2")
    late = {
        name: getattr(model.delays_s, name) + float(values[len(FREE) + k]) * _TIME_SCALE_S
        for k, name in enumerate(_TIMES)
    }
    return replace(
        model,
        inertia_kg_m2=inertia,
        friction=replace(model.friction, **numbers),
        delays_s=replace(model.delays_s, **late),
    )


def _weighed(problem: Problem, values: Floats, start: Floats, at: float) -> Floats:
    """Residuals with the far ones drawn in (Huber), and the prior's rows."""
    residual = problem.residual(_moved(problem.model, values))
    size = np.abs(residual)
    far = np.sqrt(np.maximum(2 * at * size - at * at, 0.0))
    drawn = np.where(size < at, residual, np.sign(residual) * far)
    prior = (values - start) / np.maximum(np.abs(start), 1.0)
    return np.concatenate([drawn, prior])


def _cost(problem: Problem, values: Floats, start: Floats, at: float) -> float:
    return float(np.sum(_weighed(problem, values, start, at) ** 2))


def _fit(
    problem: Problem, start: Floats, values: Floats, free: Sequence[int], at: float, steps: int
) -> tuple[Floats, float, Floats]:
    """(values, cost, deviations) with the ``free`` ones moved in at most so many steps."""
    from scipy.optimize import least_squares

    where = list(free)
    if not where:
        return values, _cost(problem, values, start, at), np.zeros(len(values))

    def of(part: Floats) -> Floats:
        trial = values.copy()
        trial[where] = part
        return _weighed(problem, trial, start, at)

    def slopes(part: Floats) -> Floats:
        here = of(part)
        moved = [part + _STEP * np.eye(len(part))[k] for k in range(len(part))]
        with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:  # compiled code frees the GIL
            return np.column_stack([(one - here) / _STEP for one in pool.map(of, moved)])

    bounds = [one.least / one.scale for one in FREE] + [-20.0] * len(_TIMES)
    low = np.array(bounds)[where]
    high = np.array([np.inf] * len(FREE) + [20.0] * len(_TIMES))[where]
    done = least_squares(
        of, inside(values[where], low, high), jac=slopes, bounds=(low, high), max_nfev=steps
    )
    result, sigma = values.copy(), np.zeros(len(values))
    result[where] = done.x
    covariance = np.linalg.pinv(done.jac.T @ done.jac)
    sigma[where] = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return result, 2.0 * float(done.cost), sigma
