"""Zoomable line plots of a self-contained page: what the script of the page is given to draw."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

DIGITS = 5
"""Significant digits of a drawn value: finer than any screen shows."""


@dataclass(frozen=True)
class Line:
    """One series over a plot's x, shape (n,); NaN leaves a gap.

    ``style`` is a key of the page's line styles; with ``band_below`` the area down to the line
    before it is filled.
    """

    label: str
    style: str
    y: Floats
    band_below: bool = False


@dataclass(frozen=True)
class Plot:
    """Lines over one x (n,); plots with the same ``sync`` share cursor and zoom."""

    name: str
    x_label: str
    y_label: str
    x: Floats
    lines: Sequence[Line]
    sync: str = ""
    height: int = 190

    def content(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "name": self.name,
            "x_label": self.x_label,
            "y_label": self.y_label,
            "sync": self.sync,
            "height": self.height,
            "lines": [
                {"label": line.label, "style": line.style, "band": line.band_below}
                for line in self.lines
            ],
            "data": [numbers(self.x, 7), *(numbers(line.y) for line in self.lines)],
        }


def numbers(values: Floats, digits: int = DIGITS) -> list[float | None]:
    """Values as JSON has them: rounded, and null where they are not finite."""
    return [float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in values.tolist()]


def thinned(values: Floats, most: int) -> npt.NDArray[np.int64]:
    """Indices of at most ``most`` samples: least and greatest of equal stretches, so peaks stay."""
    n = len(values)
    if n <= most:
        return np.arange(n)
    edges = np.linspace(0, n, max(2, most // 2) + 1).astype(np.int64)
    kept = []
    for first, last in pairwise(edges.tolist()):
        part = values[first:last]
        if len(part):
            kept += [first + int(np.argmin(part)), first + int(np.argmax(part))]
    return np.unique(np.array(kept, dtype=np.int64))


def ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round values within an axis, at most ``most``."""
    if not high > low:
        return [low]
    rough = (high - low) / most
    unit = 10.0 ** math.floor(math.log10(rough))
    step = next(unit * one for one in (1, 2, 2.5, 5, 10) if unit * one >= rough)
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 12) for k in range(first, math.floor(high / step + 1e-9) + 1)]
