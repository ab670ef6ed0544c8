"""Curves and maps for what follows no law: straight between knots, as smooth as hold-outs ask for.

Values at the knots are linear in the residual. A penalty on their bends is chosen by what one half
of the blocks says of the other.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.spread import half_widths
from eps_hil.diagnosis.remainder.sight import Sight

Floats = npt.NDArray[np.float64]

KNOTS, SIDE = 20, 8
_PENALTIES = (1e-5, 1e-3, 1e-1, 10.0)
_NO_AXIS = ("time_s", "motor_angle_rad")
_PRODUCTS = ("motor_power_w", "abs_motor_power_w")
"""A curve over these only: a map over both factors holds them."""
_BEST = 6
_RIDGE = 1e-6
_NEAR = 5
"""Samples that a knot needs near it for its value to be known at all."""
Ranges = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Table:
    """A curve or map with its gains on the fitted recordings and the hold-outs."""

    where: str
    how: str
    inputs: tuple[str, ...]
    knots: tuple[tuple[float, ...], ...]
    values: tuple[float, ...]
    fitted: float
    judged: float

    def entry(self, ranges: Ranges) -> dict[str, Any]:
        """As a model file holds it (``effects/empirical.py``)."""
        values: list[Any] = list(self.values)
        if len(self.inputs) == 2:
            wide = len(self.knots[1])
            values = [values[k : k + wide] for k in range(0, len(values), wide)]
        return {
            "effect": "empirical",
            "form": "map" if len(self.inputs) == 2 else "curve",
            "where": self.where,
            "how": self.how,
            "inputs": list(self.inputs),
            "memory": ["none"] * len(self.inputs),
            "knots": [list(axis) for axis in self.knots],
            "values": values,
            "range": {name: list(ranges[name]) for name in self.inputs if name in ranges},
        }


def tables(fitted: Sight, kept: Sight, *, maps: bool = True) -> list[Table]:
    """The best curve and, with ``maps``, the best map, better one first."""
    names = [
        name
        for name in fitted.inputs
        if name in kept.inputs and name not in _NO_AXIS and not name.endswith("_sign")
    ]
    places = [key for key in fitted.places if key in kept.places]
    over_one = [_over(fitted, kept, places, (name,), KNOTS) for name in names]
    curves = sorted(
        (of_name[k] for k in range(len(places)) for of_name in over_one),
        key=lambda one: -one.judged - one.fitted,
    )
    if not maps:
        return curves[:1]
    axes = list(dict.fromkeys(one.inputs[0] for one in curves if one.inputs[0] not in _PRODUCTS))
    axes = axes[:_BEST]
    best = list(dict.fromkeys((one.where, one.how) for one in curves))[:3]
    by_pair = [_over(fitted, kept, best, pair, SIDE) for pair in _pairs(axes)]
    over_two = [of_pair[k] for k in range(len(best)) for of_pair in by_pair]
    found = [*curves[:1], *sorted(over_two, key=lambda one: -one.judged - one.fitted)[:1]]
    return sorted(found, key=lambda one: -one.judged)


def band(sight: Sight, entry: Mapping[str, Any]) -> list[Any]:
    """95 % half widths of a table's values, in their shape; None at knots that nothing was near.

    ``sight`` is of the model with it. As smooth as the least penalty makes it, so rather too wide.
    """
    knots, names = entry["knots"], entry["inputs"]
    x, left = _columns(sight, (entry["where"], entry["how"]), names, knots)
    near = np.sum(x != 0.0, axis=0) >= _NEAR
    sizes = [len(axis) for axis in knots]
    root = np.sqrt(_PENALTIES[0] * float(np.sum(x**2)) / x.shape[1])
    smooth = root * _second(sizes)
    groups = [
        np.concatenate([one[sight.rows], np.max(one) + 1 + np.arange(len(smooth))])
        for one in (sight.block, sight.problem.stretch)
    ]
    every = np.vstack([x, smooth]), np.append(left, np.zeros(len(smooth)))
    half = half_widths(*every, groups)
    told = [
        float(f"{one:.3g}") if seen and np.isfinite(one) else None
        for one, seen in zip(half.tolist(), near, strict=True)
    ]
    if len(sizes) == 1:
        return told
    return [told[k : k + sizes[1]] for k in range(0, len(told), sizes[1])]


def _pairs(axes: Sequence[str]) -> Iterator[tuple[str, str]]:
    for one, other in combinations(axes, 2):
        if one.removeprefix("abs_") != other.removeprefix("abs_"):
            yield one, other


def _over(
    fitted: Sight, kept: Sight, places: Sequence[tuple[str, str]], names: tuple[str, ...], most: int
) -> list[Table]:
    """The table over these inputs at each of the places."""
    rows = fitted.rows
    knots = tuple(_knots(fitted.inputs[name][rows], most) for name in names)
    hats, others = (_products(sight, names, knots) for sight in (fitted, kept))
    bends = _bends([len(axis) for axis in knots])
    return [_table(fitted, kept, key, names, knots, (hats, others), bends) for key in places]


def _table(
    fitted: Sight,
    kept: Sight,
    key: tuple[str, str],
    names: tuple[str, ...],
    knots: tuple[tuple[float, ...], ...],
    hats: tuple[Floats, Floats],
    bends: Floats,
) -> Table:
    rows = fitted.rows
    x, left = _acting(fitted, key, hats[0])
    y, other = _acting(kept, key, hats[1])
    even = fitted.block[rows] % 2 == 0
    gram = [x[half].T @ x[half] for half in (even, ~even)]
    slope = [x[half].T @ left[half] for half in (even, ~even)]
    scale = float(np.trace(gram[0] + gram[1])) / len(bends)
    ridge = _RIDGE * scale * np.eye(len(bends))

    def solved(g: Floats, s: Floats, penalty: float) -> Floats:
        return np.asarray(-np.linalg.solve(g + penalty * scale * bends + ridge, s))

    def gain(g: Floats, s: Floats, v: Floats) -> float:
        return float(-2.0 * s @ v - v @ g @ v)

    def held(penalty: float) -> float:
        return sum(
            gain(gram[1 - k], slope[1 - k], solved(gram[k], slope[k], penalty)) for k in (0, 1)
        )

    penalty = max(_PENALTIES, key=held)
    values = solved(gram[0] + gram[1], slope[0] + slope[1], penalty)
    judged = gain(y.T @ y, y.T @ other, values)
    return Table(*key, names, knots, tuple(values.tolist()), held(penalty), judged)


def _knots(values: Floats, most: int) -> tuple[float, ...]:
    """Half by where samples are, half at even distances; with a knot at zero inside the range."""
    low, high = np.percentile(values, [0.2, 99.8])
    share = np.linspace(0.0, 1.0, most)
    by_count = np.quantile(np.clip(values, low, high), share)
    mixed = 0.5 * by_count + 0.5 * (low + share * (high - low))
    if low < 0.0 < high:
        mixed[np.argmin(np.abs(mixed))] = 0.0
    return tuple(np.unique(mixed).tolist())


def _columns(
    sight: Sight, key: tuple[str, str], names: Sequence[str], knots: Sequence[Sequence[float]]
) -> tuple[Floats, Floats]:
    return _acting(sight, key, _products(sight, names, knots))


def _products(sight: Sight, names: Sequence[str], knots: Sequence[Sequence[float]]) -> Floats:
    """What each knot does at the rows, (k, knots), at a place where all acts alike."""
    rows = sight.rows
    hats = _hats(sight.inputs[names[0]][rows], knots[0])
    if len(names) == 2:
        second = _hats(sight.inputs[names[1]][rows], knots[1])
        hats = (hats[:, :, None] * second[:, None, :]).reshape(len(rows), -1)
    return hats


def _acting(sight: Sight, key: tuple[str, str], hats: Floats) -> tuple[Floats, Floats]:
    rows = sight.rows
    effect = sight.places[key].effect * sight.weight / sight.scale
    return hats * effect[rows, None], (sight.residual * sight.weight)[rows]


def _hats(values: Floats, knots: Sequence[float]) -> Floats:
    return np.column_stack([np.interp(values, knots, row) for row in np.eye(len(knots))])


def _bends(sizes: Sequence[int]) -> Floats:
    """Sum of squared second differences along each axis, as a quadratic form."""
    second = _second(sizes)
    return np.asarray(second.T @ second)


def _second(sizes: Sequence[int]) -> Floats:
    """Second differences of a table's values (in a row) along each axis, a row each."""
    found = []
    for axis, size in enumerate(sizes):
        each = np.asarray(np.diff(np.eye(size), 2, axis=0), dtype=np.float64)
        parts = [each if k == axis else np.eye(n) for k, n in enumerate(sizes)]
        found.append(parts[0] if len(parts) == 1 else np.kron(*parts))
    return np.vstack(found)
