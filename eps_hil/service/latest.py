"""The newest value of every signal, for as long as it may be believed."""

import math
from collections.abc import Mapping

_CYCLES = 5
_LEAST_NS = 50_000_000


class LatestValues:
    """Values by canonical name; one that has missed five cycles (50 ms at least) is NaN.

    So is one from so far in the future: the clock was set back, and its age is unknown.
    """

    def __init__(self, period_s: Mapping[str, float]) -> None:
        self._allowed_ns = {
            name: max(round(_CYCLES * period * 1e9), _LEAST_NS) for name, period in period_s.items()
        }
        self._stamps: dict[str, int] = {}
        self._values: dict[str, float] = {}

    def take(self, name: str, t_ns: int, value: float) -> None:
        """A sample with its instant."""
        self._stamps[name], self._values[name] = t_ns, value

    def at(self, t_ns: int) -> dict[str, float]:
        """All values as of ``t_ns``; NaN for what is too old by then."""
        return {
            name: value
            if abs(t_ns - self._stamps[name]) <= self._allowed_ns.get(name, _LEAST_NS)
            else math.nan
            for name, value in self._values.items()
        }
