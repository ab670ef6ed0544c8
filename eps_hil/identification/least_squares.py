"""Weighted least squares on the torque balance, with intervals that count what hangs together once.

Gauss-Newton over all recordings. Speed noise in the acceleration would pull the inertia down; its
known share is taken out of the normal equations. Intervals come from leaving out one block of time
after the other (a jackknife), because errors within a stroke repeat themselves: white-noise
intervals would be many times too narrow.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from eps_hil.identification.balance import Case
from eps_hil.identification.state import POSITIVE, Parameter, State, get, put

Floats = npt.NDArray[np.float64]

BLOCK_S = 2.0
_ROUNDS = 12
_MOST_NOISE = 0.9
_DOUBT = 0.3
_SURE = 25.0
"""A step this short (squared, in deviations) needs no look at whether it makes things better."""
_DELAY_STEP_S = 0.006

Weights = Callable[[Case, State, Floats], Floats]
"""(case, state, residual) -> weight of each row, 1/Nm², (m,)."""


@dataclass(frozen=True)
class Rows:
    """One case's linearisation; noise is the variance that speed noise gives column ``noisy``."""

    columns: Floats
    residual: Floats
    weight: Floats
    block: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Fit:
    """A state, the covariance of its ``parameters``, and the rows it was found from."""

    state: State
    parameters: tuple[Parameter, ...]
    covariance: Floats
    rows: tuple[Rows, ...]
    blocks: int

    def sigma(self, name: str) -> float:
        """Standard deviation of a parameter; NaN for one that was not fitted."""
        for k, parameter in enumerate(self.parameters):
            if parameter.name == name:
                return float(np.sqrt(max(self.covariance[k, k], 0.0)))
        return float("nan")


def fit(
    cases: Sequence[Case],
    state: State,
    parameters: Sequence[Parameter],
    prior: State,
    weights: Weights,
    rounds: int = _ROUNDS,
) -> Fit:
    """Move ``parameters`` from ``state``; ``prior`` holds the values that the priors stand at."""
    before = np.inf
    for _ in range(rounds):
        rows = linearised(cases, state, parameters, weights)
        normal, slope = _normal(cases, rows, state, parameters, prior)
        step = np.asarray(np.linalg.solve(normal, slope), dtype=np.float64)
        size = float(step @ normal @ step)
        descend = _moved if size < _SURE else partial(_descended, cases, rows)
        state = descend(state, parameters, step)
        if size < 0.01 or (size < 1.0 and size > 0.5 * before):
            break
        before = size
    rows = linearised(cases, state, parameters, weights)
    normal, _ = _normal(cases, rows, state, parameters, prior)
    normal = _doubted(cases, rows, normal, state, parameters)
    covariance, blocks = jackknife(cases, rows, normal, state, parameters)
    return Fit(state, tuple(parameters), covariance, tuple(rows), blocks)


def linearised(
    cases: Sequence[Case], state: State, parameters: Sequence[Parameter], weights: Weights
) -> list[Rows]:
    """Residual, columns and weights of every case around ``state``."""
    found = []
    for case in cases:
        residual, columns = case.linearised(state, parameters)
        weight = np.where(case.good, weights(case, state, residual), 0.0)
        block = 100_000 * case.index + ((case.time_s - case.time_s[0]) // BLOCK_S).astype(np.int64)
        found.append(Rows(columns, residual, weight, block))
    return found


def _normal(
    cases: Sequence[Case],
    rows: Sequence[Rows],
    state: State,
    parameters: Sequence[Parameter],
    prior: State,
) -> tuple[Floats, Floats]:
    """(normal matrix, descent direction) with priors, and without the speed noise's share."""
    wide = np.array([parameter.prior for parameter in parameters])
    offset = np.array([get(prior, p.name) - get(state, p.name) for p in parameters])
    normal, slope = np.diag(wide**-2.0), offset / wide**2
    for case, one in zip(cases, rows, strict=True):
        weighted = one.columns * one.weight[:, None]
        normal = normal + weighted.T @ one.columns
        slope = slope - weighted.T @ one.residual
        excess, pull = noise_share(case, one, state, parameters)
        normal, slope = normal - excess, slope + pull
    return normal, slope


def noise_share(
    case: Case, one: Rows, state: State, parameters: Sequence[Parameter]
) -> tuple[Floats, Floats]:
    """What noise in columns adds to the normal matrix, and how it pulls at the inertia.

    Noise of a derivative is uncorrelated with the noise it is the derivative of, so delays are not
    pulled at; but their columns' noise must not pass for knowledge.
    """
    excess, pull = np.zeros((len(parameters),) * 2), np.zeros(len(parameters))
    for k, parameter in enumerate(parameters):
        variance = case.noise_variance(state, parameter.name)
        if variance > 0:
            power = float(one.weight.sum()) * variance
            power = min(power, _MOST_NOISE * float(one.weight @ one.columns[:, k] ** 2))
            excess[k, k] = power
            if parameter.name == "inertia_kg_m2":
                pull[k] = power * state.model.inertia_kg_m2
    return excess, pull


def expected(
    cases: Sequence[Case], state: State, parameters: Sequence[Parameter], weights: Weights
) -> Floats:
    """Covariance that rows could have at best: nothing left but sensor noise."""
    rows = []
    for one, case in zip(linearised(cases, state, parameters, weights), cases, strict=True):
        top = float(one.weight.max())
        scale = case.floor_nm(state.model) ** -2 / top if top > 0 else 0.0
        rows.append(Rows(one.columns, 0.0 * one.residual, one.weight * scale, one.block))
    normal, _ = _normal(cases, rows, state, parameters, state)
    sure = _doubted(cases, rows, normal, state, parameters)
    return np.asarray(np.linalg.inv(sure), dtype=np.float64)


def _doubted(
    cases: Sequence[Case],
    rows: Sequence[Rows],
    normal: Floats,
    state: State,
    parameters: Sequence[Parameter],
) -> Floats:
    """The normal matrix without what may be noise after all, nowhere below the priors.

    How strong noise is is known to some per cent only. Where columns nearly add up to nothing (a
    motor that is a spring of the same motion), that much of it would look like knowledge.
    """
    for case, one in zip(cases, rows, strict=True):
        normal = normal - _DOUBT * noise_share(case, one, state, parameters)[0]
    prior = np.array([p.prior for p in parameters])
    value, vector = np.linalg.eigh(normal * np.outer(prior, prior))
    safe = (vector * np.maximum(value, 1.0)) @ vector.T
    return np.asarray(safe / np.outer(prior, prior), dtype=np.float64)


def jackknife(
    cases: Sequence[Case],
    rows: Sequence[Rows],
    normal: Floats,
    state: State,
    parameters: Sequence[Parameter],
) -> tuple[Floats, int]:
    """Covariance from the fits without one block each (one Newton step), and how many blocks."""
    changes = []
    for case, one in zip(cases, rows, strict=True):
        excess, pull = noise_share(case, one, state, parameters)
        total = max(float(one.weight.sum()), 1e-300)
        for number in np.unique(one.block[one.weight > 0]):
            mine = one.block == number
            part = float(one.weight[mine].sum()) / total
            weighted = one.columns[mine] * one.weight[mine, None]
            kept = normal - weighted.T @ one.columns[mine] + part * excess
            slope = -weighted.T @ one.residual[mine] + part * pull
            changes.append(-np.linalg.lstsq(kept, slope, rcond=None)[0])
    if len(changes) < 2:
        return np.asarray(np.linalg.inv(normal) * 1e4, dtype=np.float64), len(changes)
    moved = np.array(changes)
    moved -= moved.mean(axis=0)
    n = len(moved)
    prior = np.diag([p.prior**-2.0 for p in parameters])
    inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    covariance = (n - 1) / n * moved.T @ moved + inverse @ prior @ inverse
    return np.asarray(covariance, dtype=np.float64), n


def _descended(
    cases: Sequence[Case],
    rows: Sequence[Rows],
    state: State,
    parameters: Sequence[Parameter],
    step: Floats,
) -> State:
    """The state after the step, or after a part of it where all of it makes things worse."""
    now = sum(float(one.weight @ one.residual**2) for one in rows)
    for _ in range(4):
        trial = _moved(state, parameters, step)
        cost = sum(
            float(one.weight @ case.residual(trial) ** 2)
            for case, one in zip(cases, rows, strict=True)
        )
        if cost < 1.01 * now:
            break
        step = 0.4 * step
    return trial


def _moved(state: State, parameters: Sequence[Parameter], step: Floats) -> State:
    for wanted, parameter in zip(step.tolist(), parameters, strict=True):
        value = get(state, parameter.name)
        low, high = -np.inf, np.inf
        if parameter.name.startswith("delays_s."):
            low, high = -_DELAY_STEP_S, _DELAY_STEP_S
        elif parameter.name in POSITIVE:
            low, high = -0.6 * value, 1.5 * value
        state = put(state, parameter.name, value + min(max(wanted, low), high))
    return state
