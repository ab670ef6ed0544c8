"""One more unknown beside the fitted ones, from one step: is a gain off, is there a motor lag?

Its column is made of a noisy signal whose noise is in the balance too. Where the other columns
explain the rest of it (a motor that carries the preload it is told to carry is the rack force
itself), least squares would see that noise alone and set the unknown by it. So the known power of
the noise is taken out, as for the inertia, and without much more than noise nothing is claimed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.identification.balance import Case
from eps_hil.identification.least_squares import Fit, noise_share
from eps_hil.identification.state import State

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Column:
    """d residual / d unknown, (m,); the variance of its noise, and its covariance with the row's.

    Both are of the noise in one filtered row.
    """

    values: Floats
    variance: float
    together: float


@dataclass(frozen=True, slots=True)
class Found:
    """The unknown (0 is as modelled) and its deviation, inf where the recordings do not show it."""

    value: float
    sigma: float
    moves: Floats | None = None
    """What one of it moves each of the fit's parameters by, (p,)."""


NOTHING = Found(0.0, float("inf"))


def extra_regressor(
    cases: Sequence[Case],
    state: State,
    fit: Fit,
    column: Callable[[Case], Column],
    least_share: float = 1.0,
) -> Found:
    """The unknown of ``column`` with all of the fit's parameters free, held by their priors.

    Nothing is claimed unless what the unknown moves has ``least_share`` times the power of the
    noise in it, its own column's and that of the parameters which move along.
    The deviation is over blocks of time, with what only the priors hold counted as unknown.
    """
    prior = np.diag([*(p.prior**-2.0 for p in fit.parameters), 0.0])
    normal, noise, scores, products = prior.copy(), 0.0 * prior, [], []
    for case, one in zip(cases, fit.rows, strict=True):
        mine = column(case)
        columns = np.column_stack([one.columns, mine.values])
        weighted = columns * one.weight[:, None]
        total = max(float(one.weight.sum()), 1e-300)
        excess, pull = noise_share(case, one, state, fit.parameters)
        pulls = np.append(pull, total * mine.together)
        apart = np.pad(excess, (0, 1))
        apart[-1, -1] = total * mine.variance
        noise += apart
        residual = case.residual(state)
        for number in np.unique(one.block[one.weight > 0]):
            rows = one.block == number
            part = float(one.weight[rows].sum()) / total
            scores.append(part * pulls - weighted[rows].T @ residual[rows])
            products.append(weighted[rows].T @ columns[rows] - part * apart)
        normal += weighted.T @ columns - apart
    return _solved(normal, prior, least_share * noise, np.array(scores), np.array(products))


def _solved(
    normal: Floats, prior: Floats, noise: Floats, scores: Floats, products: Floats
) -> Found:
    others = np.linalg.solve(normal[:-1, :-1], normal[:-1, -1])
    direction = np.append(-others, 1.0)
    own = float(normal[-1] @ direction)
    if own <= float(direction @ noise @ direction) or own <= 0.0:
        return NOTHING
    alone = scores @ direction
    value = float(alone.sum()) / own
    left = alone - value * (products @ direction) @ direction
    held = float(others @ prior[:-1, :-1] @ others)
    return Found(
        value, float(np.sqrt(np.sum(left**2) + held)) / own, np.asarray(-others, dtype=np.float64)
    )
