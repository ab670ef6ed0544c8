"""What a model leaves beyond the sensors' noise on a real machine, estimated with the model.

A remainder is normal: friction that follows no smooth law, an inverter, heat. Compared with the
sensors' noise alone it closes every gate; taken for evidence it lets anything pass. So the residual
is y = J θ + Φ w + e: θ the numbers of the model that is judged, Φ hat functions over one and two
measured coordinates and over time (a discrepancy term as Kennedy and O'Hagan's, J. R. Stat. Soc. B
63, 2001), e noise. The variance of w is estimated for each coordinate, and that of e, by MacKay's
evidence updates (automatic relevance determination, Neural Computation 4, 1992). What a name is
worth is the difference of two log evidences, each with a discrepancy of its own: a free curve pays
for every knot, a law of the catalogue for its few numbers only, and a name that stands in for
something unknown saves none of the knots. What Φ does not hold lasts: the difference is divided by
the design effect, the variance of a score over blocks in time by that over samples.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve, cholesky
from scipy.linalg.lapack import dtrtri

from eps_hil.diagnosis.balance.coordinates import coordinates_of
from eps_hil.diagnosis.balance.problem import SLIDING_RAD_S, Problem, huber

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

KNOTS, KNOTS_OF_PLACE, KNOTS_OF_TWO = 10, 40, 5
TIME_S, MOST_TIME_KNOTS = 4.0, 40
"""Between knots over a recording's time, and how many there are at most."""
_ROUNDS, _SETTLED = 60, 0.3
"""Of evidence updates, and the change of the log evidence (nats) that ends them."""
_NONE = 1e-3
"""Variance of a coordinate's curve, in noise variances, below which there is none."""
_PLACE, _SPEED, _FORCE, _TORQUE = (
    "rack_position_m",
    "motor_speed_rad_s",
    "rack_force_n",
    "motor_torque_nm",
)
_SMOOTH = 15
"""Thinned samples over which the torque's way is told."""


@dataclass(frozen=True)
class Basis:
    """Hat functions over the coordinates of some recordings, for those and for others."""

    lines: Mapping[str, Floats]
    """Knots over one coordinate…"""
    rough: Mapping[str, Floats]
    """…and of its share in hats over two."""
    sizes: Mapping[str, float]
    """Usual sizes of what hats are multiplied with."""
    apart_s: float

    @classmethod
    def of(cls, problem: Problem) -> "Basis":
        """The basis for a problem's sliding samples."""
        at, use = coordinates_of(problem.recordings, problem.model), problem.sliding
        moving = [name for name in at if name != "time_s" and np.ptp(at[name][use]) > 0.0]
        count = {name: KNOTS_OF_PLACE if name == _PLACE else KNOTS for name in moving}
        lines = {name: _knots(at[name][use], count[name]) for name in moving}
        two = [name for name in (_SPEED, _PLACE, _FORCE, _TORQUE) if name in moving]
        rough = {name: _knots(at[name][use], KNOTS_OF_TWO) for name in two}
        sizes = {name: float(np.std(at[name][use])) for name in (_FORCE, _TORQUE)}
        rate = np.abs(_rate(at[_TORQUE]))[use]
        sizes["turn"] = float(np.median(rate)) if len(rate) else 0.0
        total = sum(float(np.ptp(one.thin_time_s)) for one in problem.recordings)
        return cls(lines, rough, sizes, max(TIME_S, total / MOST_TIME_KNOTS))

    def columns(self, problem: Problem) -> tuple[Floats, Integers]:
        """Φ (n, q) in the units of the residual, and the group of each column."""
        at = coordinates_of(problem.recordings, problem.model)
        way = np.tanh(at[_SPEED] / (SLIDING_RAD_S * problem.size.angle))
        load, torque = (at[name] / max(self.sizes[name], 1e-300) for name in (_FORCE, _TORQUE))
        turn = np.tanh(_rate(at[_TORQUE]) / max(self.sizes["turn"], 1e-300))
        blocks: list[Floats] = []
        for name, knots in self.lines.items():
            hats = _hats(at[name], knots)
            factors = [np.ones(len(way)), turn, *([] if name == _SPEED else [way])]
            factors += [load, torque] if name == _PLACE else []
            blocks += [hats * factor[:, None] for factor in factors if np.any(factor)]
        rough = {name: _hats(at[name], knots) for name, knots in self.rough.items()}
        for a, b in combinations(rough.values(), 2):
            blocks.append((a[:, :, None] * b[:, None, :]).reshape(len(way), -1))
        time = _over_time(problem, self.apart_s)
        blocks += [time, time * way[:, None], time * torque[:, None]]
        group = np.concatenate([np.full(one.shape[1], k) for k, one in enumerate(blocks)])
        size = problem.floor / problem.scale
        return np.hstack(blocks) * np.where(problem.sliding, size, 0.0)[:, None], group


@dataclass(frozen=True)
class Evidence:
    """Log evidence (nats) of a model with a discrepancy of its own.

    ``variance`` of each group of Φ's columns and ``sigma`` of the noise are in noise floors.
    """

    log: float
    variance: Floats
    sigma: float
    weights: Floats


@dataclass(frozen=True)
class Whitening:
    """A discrepancy as a covariance: what a problem's residuals are divided by the root of."""

    basis: Basis
    variance: Floats
    sigma: float

    def span(self, problem: Problem) -> Floats:
        """P (n, r): residuals less P Pᵀ of them are as large as the noise in every direction."""
        columns, group = self.basis.columns(problem)
        live = self.variance[group] > 0.0
        columns = columns[:, live] * (np.sqrt(self.variance[group[live]]) / self.sigma)
        squared, turned = np.linalg.eigh(columns.T @ columns)
        good = squared > 1e-3
        squared, turned = squared[good], turned[:, good]
        less = 1.0 - 1.0 / np.sqrt(1.0 + squared)
        return np.asarray(columns @ (turned * np.sqrt(less / squared)))


class Discrepancy:
    """What models of one problem are worth beside a discrepancy that is estimated with each."""

    def __init__(self, problem: Problem, residual: Floats) -> None:
        """``residual`` (n,) of a fit nearby says what counts as an outlier."""
        self.basis = Basis.of(problem)
        self._problem = problem
        self._independent = problem.independent / max(float(np.sum(problem.sliding)), 1.0)
        self._root = np.sqrt(huber(residual, problem.knee)) * problem.sliding
        columns, group = self.basis.columns(problem)
        self._columns, self._group = columns * self._root[:, None], group
        self._gram = self._columns.T @ self._columns

    def evidence(
        self, residual: Floats, jacobian: Floats, like: Evidence | None = None
    ) -> Evidence:
        """Of a ``residual`` (n,) beside free numbers with the sensitivities ``jacobian`` (n, p)."""
        q = _orthonormal(jacobian * self._root[:, None])
        y = residual * self._root
        y = y - q @ (q.T @ y)
        across = q.T @ self._columns
        count = float(np.sum(self._problem.sliding)) - q.shape[1]
        gram, slope = self._gram - across.T @ across, self._columns.T @ y
        # as much as rounding may have made it less than positive semidefinite
        lost = len(gram) * np.finfo(np.float64).eps * np.diag(self._gram)
        gram[np.diag_indices(len(gram))] += lost
        start = None if like is None else (like.variance, like.sigma**2)
        return _updated(
            self._independent * gram,
            self._independent * slope,
            self._independent * float(y @ y),
            self._independent * count,
            self._group,
            start,
        )

    def whitening(self, found: Evidence) -> Whitening:
        """The covariance that goes with a model's evidence."""
        return Whitening(self.basis, found.variance, found.sigma)

    def design_effect(
        self, residual: Floats, others: Floats, columns: Floats, found: Evidence
    ) -> float:
        """How many samples are one observation of the numbers with ``columns`` (n, k).

        Variance of their score over blocks and stretches in time, over that of samples alone;
        ``others`` (n, p) are the sensitivities of all other numbers.
        """
        live = found.variance[self._group] > 0.0
        curves = self._columns[:, live]
        curves = curves * (np.sqrt(found.variance[self._group[live]]) / found.sigma)
        size = np.sqrt(np.sum(others**2, axis=0)) + 1e-300
        beside = np.hstack([others / size * self._root[:, None], curves])
        ridge = np.concatenate([np.full(others.shape[1], 1e-9), np.ones(curves.shape[1])])
        normal = beside.T @ beside + np.diag(ridge)
        both = np.column_stack([columns, residual]) * self._root[:, None]
        both = both - beside @ np.linalg.solve(normal, beside.T @ both)
        column, left = both[:, :-1], both[:, -1]
        left = left - column @ np.linalg.lstsq(column, left, rcond=None)[0]
        worst = 1.0
        for groups in (self._problem.block, self._problem.stretch):
            for one in column.T:
                scores = np.bincount(groups, one * left)
                alone = float(np.sum((one * left) ** 2))
                worst = max(worst, float(np.sum(scores**2)) / max(alone, 1e-300))
        return worst


def _updated(
    gram: Floats,
    slope: Floats,
    energy: float,
    count: float,
    group: Integers,
    start: tuple[Floats, float] | None,
) -> Evidence:
    """MacKay's fixed point for the variance of each group and of the noise."""
    groups = int(group.max()) + 1
    diagonal = np.diag(gram)
    typical = np.bincount(group, diagonal, groups) / np.bincount(group, minlength=groups) / count
    variance, noise = (np.full(groups, energy / count), energy / count) if start is None else start
    log, found = -np.inf, Evidence(-np.inf, variance, 1.0, np.zeros(len(group)))
    for _ in range(_ROUNDS):
        live = variance * typical > _NONE * noise
        use = np.flatnonzero(live[group])
        root, part = np.sqrt(variance[group[use]]), gram[np.ix_(use, use)]
        inner = part * (root[:, None] * root[None, :] / noise)
        inner[np.diag_indices(len(inner))] += 1.0
        factor = cholesky(inner, lower=True, check_finite=False)
        mean = root * cho_solve((factor, True), root * slope[use], check_finite=False) / noise
        explained = float(slope[use] @ mean)
        bent = 2.0 * float(np.sum(np.log(np.diag(factor))))
        before, log = log, -0.5 * (count * np.log(noise) + bent + (energy - explained) / noise)
        weights = np.zeros(len(group))
        weights[use] = mean
        found = Evidence(log, np.where(live, variance, 0.0), float(np.sqrt(noise)), weights)
        if abs(log - before) < _SETTLED:
            break
        inverse = dtrtri(factor, lower=1)[0] if len(use) else factor  # LAPACK takes no empty one
        told = 1.0 - np.sum(inverse**2, axis=0)  # less the diagonal of inner's inverse
        number = np.bincount(group[use], told, groups)
        square = np.bincount(group[use], mean**2, groups)
        variance = np.where(number > 1e-9, square / np.maximum(number, 1e-9), 0.0)
        left = energy - 2.0 * explained + float(mean @ part @ mean)
        noise = max(left, 1e-9 * energy) / max(count - float(np.sum(told)), 1.0)
    return found


def _orthonormal(columns: Floats) -> Floats:
    size = np.sqrt(np.sum(columns**2, axis=0))
    if not np.any(size > 0.0):
        return np.zeros((len(columns), 0))
    q, r = np.linalg.qr(columns[:, size > 0.0] / size[size > 0.0])
    return np.asarray(q[:, np.abs(np.diag(r)) > 1e-6])


def _knots(x: Floats, count: int) -> Floats:
    """Between the outermost half percents, half by visits and half by way."""
    level = np.linspace(0.005, 0.995, count)
    low, high = (float(end) for end in np.quantile(x, (0.005, 0.995)))
    return np.unique(0.5 * (np.quantile(x, level) + np.linspace(low, high, count)))


def _hats(x: Floats, knots: Floats) -> Floats:
    return np.column_stack([np.interp(x, knots, row) for row in np.eye(len(knots))])


def _rate(torque: Floats) -> Floats:
    """Change of a torque from one thinned sample to the next, smoothed."""
    window = np.hanning(_SMOOTH)
    return np.gradient(np.convolve(torque, window / np.sum(window), mode="same"))


def _over_time(problem: Problem, apart_s: float) -> Floats:
    """Hat functions over each recording's time, (n, k)."""
    parts: Sequence[Floats] = [
        _hats(t, np.linspace(t[0], t[-1], max(2, round(float(np.ptp(t)) / apart_s) + 1)))
        for t in (one.thin_time_s for one in problem.recordings)
    ]
    out = np.zeros((sum(len(one) for one in parts), sum(one.shape[1] for one in parts)))
    row = column = 0
    for one in parts:
        out[row : row + len(one), column : column + one.shape[1]] = one
        row, column = row + len(one), column + one.shape[1]
    return out
