"""What a flexible model could still take off the hold-outs: a bound that no law is held back by.

Boosted trees (Friedman, Ann. Statist. 29, 2001) of one split a level (as CatBoost grows them) over
every recorded input, their sizes, lags and heats, fitted to what a model leaves of the recordings.
How many trees is chosen by one half of the stretches for the other; hold-outs only judge.
"""

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee
from eps_hil.diagnosis.remainder.sight import Sight
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]
Bins = npt.NDArray[np.int64]

_TREES, _DEPTH, _BINS, _RATE = 200, 4, 32, 0.1
_LEAST = 20.0
"""Samples that a leaf's mean is drawn towards zero with."""
_LAGS_S, _HEAT_S = (0.1, 2.0), 10.0
_REMEMBERED = ("motor_speed_rad_s", "motor_torque_nm", "abs_rack_force_n", "torque_sensor_nm")
_FEWEST = 500


def left_by_trees(problem: Problem, kept: Problem, model: Model) -> Floats:
    """Residual (m,) of the hold-outs ``kept`` under ``model``, less what trees say of it.

    In noise deviations; the trees are grown on ``problem`` under the same model. As it is where too
    little slides, or where no tree is worth it.
    """
    left = kept.residual(model)
    fitted, judged = Sight(problem, model), Sight(kept, model)
    if int(np.sum(fitted.use)) < _FEWEST or not judged.use.any():
        return left
    names = [name for name in fitted.inputs if name in judged.inputs]
    columns, others = (_features(one, names) for one in (fitted, judged))
    rows = np.flatnonzero(fitted.use)
    edges = [np.unique(np.quantile(one[rows], np.linspace(0, 1, _BINS + 1)[1:-1]))
             for one in columns]  # fmt: skip
    x = np.column_stack([np.searchsorted(e, c[rows]) for e, c in zip(edges, columns, strict=True)])
    z = np.column_stack([np.searchsorted(e, c) for e, c in zip(edges, others, strict=True)])
    y = clipped(fitted.residual, knee(fitted.residual))[rows]
    even = problem.stretch[rows] % 2 == 0
    if even.all() or not even.any():
        even = problem.block[rows] % 2 == 0
    curves = [_curve(_grown(x[half], y[half], x[~half]), y[~half]) for half in (even, ~even)]
    count = int(np.argmin(curves[0] + curves[1]))
    return left if count == 0 else left - _grown(x, y, z, count)[-1]


def _features(sight: Sight, names: list[str]) -> list[Floats]:
    found = [sight.inputs[name] for name in names]
    for name in _REMEMBERED:
        if name in names:
            found += [sight.remembered(name, "lag", lag) for lag in _LAGS_S]
            found.append(sight.remembered(name, "heat", _HEAT_S))
    return found


def _curve(guesses: Floats, y: Floats) -> Floats:
    """Squared error (trees + 1,) after each tree, none first."""
    return np.concatenate([[np.sum(y**2)], np.sum((y - guesses) ** 2, axis=1)])


def _grown(x: Bins, y: Floats, z: Bins, trees: int = _TREES) -> Floats:
    """Guesses (trees, m) for rows ``z`` after each tree grown on ``x`` (n, features) and ``y``."""
    left, guess, columns = y.copy(), np.zeros(len(z)), np.ascontiguousarray(x.T)
    guesses = np.empty((trees, len(z)))
    for k in range(trees):
        leaf, other = np.zeros(len(x), np.int64), np.zeros(len(z), np.int64)
        for _ in range(_DEPTH):
            feature, cut = _split(columns, left, leaf, int(leaf.max()) + 1)
            leaf = 2 * leaf + (columns[feature] > cut)
            other = 2 * other + (z[:, feature] > cut)
        sums = np.bincount(leaf, left, 2**_DEPTH)
        value = _RATE * sums / (np.bincount(leaf, minlength=2**_DEPTH) + _LEAST)
        left -= value[leaf]
        guess = guess + value[other]
        guesses[k] = guess
    return guesses


def _split(columns: Bins, left: Floats, leaf: Bins, leaves: int) -> tuple[int, int]:
    """The feature and its bin whose split of all leaves at once takes off most."""
    held = np.zeros((2, len(columns), leaves, _BINS))
    _fill(columns, left, leaf, held)
    sums, counts = np.cumsum(held, axis=-1)
    above, more = sums[..., -1:] - sums, counts[..., -1:] - counts
    gain = np.sum(sums**2 / (counts + _LEAST) + above**2 / (more + _LEAST), axis=1)[:, :-1]
    feature, cut = np.unravel_index(int(np.argmax(gain)), gain.shape)
    return int(feature), int(cut)


@njit
def _fill(columns: Bins, left: Floats, leaf: Bins, held: Floats) -> None:
    """Sums of ``left``, and how many, by feature, leaf and bin."""
    for feature in range(columns.shape[0]):
        for row in range(columns.shape[1]):
            held[0, feature, leaf[row], columns[feature, row]] += left[row]
            held[1, feature, leaf[row], columns[feature, row]] += 1.0
