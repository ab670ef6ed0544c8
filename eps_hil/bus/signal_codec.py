"""One DBC signal between its raw number and a value, with what makes a value no value."""

import math
import re
import sys
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

_NO_VALUE = re.compile(
    r"sna|signal\W?not\W?available|not\W?available|n/?a|invalid|not\W?valid|undefined|error|fault",
    re.IGNORECASE,
)
_HALF_QUANTUM = 0.5001
_EXACT = 1 << 53
_LARGEST = sys.float_info.max
"""What a signal without a range stays within: an infinity is no value."""


def no_value_raws(signal: Any) -> frozenset[int]:
    """Raw numbers that the value table labels as 'signal not available', 'invalid' or alike."""
    labels = {raw: str(label).replace("_", " ") for raw, label in (signal.choices or {}).items()}
    return frozenset(raw for raw, label in labels.items() if _NO_VALUE.fullmatch(label.strip()))


class Law(NamedTuple):
    """How a raw number becomes a value: none where it is ``labelled``, or raw · ``scale`` +
    ``shifted`` lies outside of ``low`` to ``high``; else that times ``factor`` plus ``offset``."""

    labelled: frozenset[int]
    scale: float
    shifted: float
    low: float
    high: float
    factor: float
    offset: float


class ReadSignal:
    """Raw number -> canonical value; NaN where the sender says so or the DBC's range is left."""

    __slots__ = (
        "_factor", "_high", "_linear", "_low", "_none", "_offset", "_shift",
        "canonical", "name",
    )  # fmt: skip

    def __init__(self, signal: Any, canonical: str, factor: float, offset: float) -> None:
        self.name: str = signal.name
        self.canonical = canonical
        self._factor, self._offset = factor, offset
        self._none = no_value_raws(signal)
        self._linear, self._shift = signal.scale, signal.offset
        slack = 0.0 if signal.is_float else _HALF_QUANTUM * abs(float(signal.scale))
        self._low = -_LARGEST if signal.minimum is None else float(signal.minimum) - slack
        self._high = _LARGEST if signal.maximum is None else float(signal.maximum) + slack

    @property
    def law(self) -> Law:
        """The numbers behind :meth:`read`."""
        return Law(
            self._none, self._linear, self._shift, self._low, self._high,
            self._factor, self._offset,
        )  # fmt: skip

    def read(self, raw: Any) -> float:
        """Canonical value of a raw number, or NaN."""
        if raw in self._none:
            return math.nan
        value = float(raw * self._linear + self._shift)
        if not self._low <= value <= self._high:
            return math.nan
        return value * self._factor + self._offset

    def read_all(
        self, raw: npt.NDArray[Any]
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """:meth:`read` of raw numbers (n,), and where the sender says that there is no value."""
        none = np.isin(raw, list(self._none)) if self._none else np.zeros(len(raw), bool)
        if raw.dtype.kind == "f":
            none |= np.isnan(raw)
        elif len(raw) and not self.exact(int(raw.min()), int(raw.max())):
            return np.array([self.read(each) for each in raw.tolist()]), none
        with np.errstate(all="ignore"):
            value = raw.astype(np.float64) * self._linear + self._shift
            good = (self._low <= value) & (value <= self._high) & ~none
            return np.where(good, value * self._factor + self._offset, math.nan), none

    def exact(self, least: int, most: int) -> bool:
        """Whether floats hold what whole numbers in this range come to on the way."""
        size = max(abs(least), abs(most))
        if isinstance(self._linear, int):
            size = max(size, size * abs(self._linear) + abs(self._shift))
        return size < _EXACT

    def why_not(self, raw: Any) -> str:
        """The fault of a raw number that read as NaN."""
        return "not_available" if raw in self._none or math.isnan(raw) else "out_of_range"


class WriteSignal:
    """Value in the DBC's unit -> raw number within its range and width."""

    __slots__ = ("_float", "_high", "_low", "_missing", "_none", "_offset", "_scale", "name")

    def __init__(self, signal: Any) -> None:
        self.name: str = signal.name
        self._float: bool = bool(signal.is_float)
        self._scale, self._offset = float(signal.scale), float(signal.offset)
        width = signal.length
        limits = (
            (-(2 ** (width - 1)), 2 ** (width - 1) - 1) if signal.is_signed else (0, 2**width - 1)
        )
        given = sorted(
            (bound - self._offset) / self._scale
            for bound in (signal.minimum, signal.maximum)
            if bound is not None
        )
        self._low: float = limits[0]
        self._high: float = limits[1]
        if self._float:
            self._low, self._high = (given[0], given[1]) if len(given) == 2 else (-1e38, 1e38)
        elif len(given) == 2:
            self._low = max(limits[0], math.ceil(given[0] - 1e-3))
            self._high = min(limits[1], math.floor(given[1] + 1e-3))
        none = sorted(no_value_raws(signal))
        self._none: int | None = none[-1] if none else None
        initial = signal.raw_initial
        self._missing = initial if initial is not None else min(max(0, self._low), self._high)

    @property
    def real(self) -> bool:
        """Whether the raw number is a float."""
        return self._float

    @property
    def law(self) -> tuple[float, float, float, float]:
        """(scale, offset, low, high): the raw number of a value is (value - offset) / scale, and
        lies between the last two."""
        return self._scale, self._offset, self._low, self._high

    @property
    def reach(self) -> tuple[float, float]:
        """The least and the largest value that is written as it is."""
        ends = (raw * self._scale + self._offset for raw in (self._low, self._high))
        low, high = sorted(ends)
        return low, high

    def write(self, value: float) -> tuple[int | float, int]:
        """Raw number, and its fate: 0 as it was, 1 clipped, -1 there was no value."""
        raw: float = (value - self._offset) / self._scale
        if self._low < raw < self._high:  # as almost always
            return (raw if self._float else round(raw)), 0
        if math.isnan(value):
            return (self._missing if self._none is None else self._none), -1
        if raw <= self._low:
            return self._low, int(raw < self._low - _HALF_QUANTUM)
        return self._high, int(raw > self._high + _HALF_QUANTUM)
