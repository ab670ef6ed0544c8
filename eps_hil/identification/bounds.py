"""A start of a bounded fit: no other fit's result is surely within the bounds of the next."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_MARGIN = 1e-6
"""Of the range: a start on a bound has a slope in one direction only."""


def inside(start: npt.ArrayLike, low: Floats, high: Floats) -> Floats:
    """``start`` (n,) moved to strictly between ``low`` and ``high``; either may be infinite."""
    at = np.asarray(start, dtype=np.float64)
    span = np.where(np.isfinite(high - low), high - low, np.maximum(np.abs(at), 1.0))
    return np.asarray(np.clip(at, low + _MARGIN * span, high - _MARGIN * span))
