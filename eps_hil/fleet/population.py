"""A population of rigs: each quantity over units and time, its middle, spread and outliers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eps_hil.fleet.job import Row

_SIGMA_OF_MAD = 1.4826
_FAR = 3.5
FEWEST = 5
"""Values below which none is called an outlier."""


@dataclass(frozen=True, slots=True)
class Point:
    """One recording's value of a quantity; ``low``, ``high``: its 95 % interval, or None.

    ``start_s``: since 1970; None where the recording has no date.
    """

    recording: str
    unit: str
    start_s: float | None
    value: float
    low: float | None
    high: float | None
    outlier: bool = False


@dataclass(frozen=True, slots=True)
class Quantity:
    """Values by unit and time. ``middle``: their median; ``spread``: scaled median deviation.

    ``between`` and ``within``: the same spread of the units' medians, and of what is left within
    units; None where units or recordings are too few.
    """

    name: str
    si: str
    points: tuple[Point, ...]
    middle: float
    spread: float
    between: float | None
    within: float | None


def population(rows: Sequence[Row]) -> list[Quantity]:
    """Every quantity of the rows that are done, by name.

    An outlier is further from the median than 3.5 robust standard deviations with all of its
    interval; of fewer than five values none is called so.
    """
    found: dict[tuple[str, str], list[Point]] = {}
    for row in rows:
        for one in row["values"]:
            point = Point(
                row["recording"], row["unit"], row["start_s"],
                one["value"], one["low"], one["high"],
            )  # fmt: skip
            if np.isfinite(point.value):
                found.setdefault((one["quantity"], one["si"]), []).append(point)
    return [_quantity(name, si, points) for (name, si), points in sorted(found.items())]


def _quantity(name: str, si: str, points: list[Point]) -> Quantity:
    values = np.array([point.value for point in points])
    middle, spread = float(np.median(values)), _spread(values)
    judged = []
    for point in sorted(points, key=_place):
        nearest = min(
            (abs(edge - middle) for edge in (point.low, point.high) if edge is not None),
            default=abs(point.value - middle),
        )
        across = point.low is not None and point.high is not None
        if across and (point.low or 0.0) <= middle <= (point.high or 0.0):
            nearest = 0.0
        far = len(points) >= FEWEST and spread > 0.0 and nearest > _FAR * spread
        judged.append(
            Point(point.recording, point.unit, point.start_s, point.value, point.low, point.high,
                  bool(far))
        )  # fmt: skip
    units: dict[str, list[float]] = {}
    for point in points:
        units.setdefault(point.unit, []).append(point.value)
    medians = np.array([np.median(of) for of in units.values()])
    left = np.concatenate([np.array(of) - np.median(of) for of in units.values() if len(of) > 1]
                          or [np.zeros(0)])  # fmt: skip
    return Quantity(
        name, si, tuple(judged), middle, spread,
        _spread(medians) if len(medians) >= FEWEST else None,
        _spread(left) if len(left) >= FEWEST else None,
    )  # fmt: skip


def _place(point: Point) -> tuple[str, bool, float, str]:
    """By unit and time; those without a date by their path, after the others."""
    return point.unit, point.start_s is None, point.start_s or 0.0, point.recording


def _spread(values: np.ndarray) -> float:
    return _SIGMA_OF_MAD * float(np.median(np.abs(values - np.median(values))))
