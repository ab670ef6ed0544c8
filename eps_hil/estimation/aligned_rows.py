"""The stream's signals side by side on its 1 kHz grid, for whoever else wants physical instants.

The same rings, delays and interpolation as the estimator's, with nothing behind them; so what is
read depends on nothing but samples and stamps, live as in a replay.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.estimation import alignment
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import STEP_NS, STEP_S
from eps_hil.estimation.stream_steps import Memory, new_memory, push, time_jumped
from eps_hil.estimation.stream_timing import SIGNALS, Timing, timing_of
from eps_hil.physics.model import Model

_MOST = 1_100

Float64 = npt.NDArray[np.float64]
Int64 = npt.NDArray[np.int64]


@kernel
def _advance(m: Memory, timing: Timing, t: int, at: Int64, rows: Float64) -> int:
    """Read what is due by sync stamp ``t`` into ``at`` and ``rows``; how many."""
    if m.grid[1] == 0:
        m.grid[0], m.grid[1] = t, 1
    elif time_jumped(m.grid, STEP_NS, t):
        m.grid[0] = t
        m.filled[:] = 0
    m.grid[2] = t
    n = 0
    while m.grid[0] <= t + STEP_NS // 2 and n < _MOST:
        at[n] = m.grid[0] - timing.lookback
        for i in range(len(SIGNALS)):
            rows[n, i] = math.nan
            if timing.used[i]:
                value, lost = alignment.read_at(
                    m.stamps, m.values, m.filled, i, at[n] + timing.delay[i], timing.stale[i], 1
                )
                if lost == 0:
                    rows[n, i] = value
        m.grid[0] += STEP_NS
        n += 1
    return n


class AlignedRows:
    """:meth:`push` every sample, :meth:`advance` at every sync frame, then read :meth:`rows`."""

    def __init__(
        self, model: Model, settings: EstimatorSettings, periods_s: Mapping[str, float]
    ) -> None:
        """``ValueError`` where motor torque, or both speed and angle, are missing."""
        slow = replace(settings, step_s=STEP_S)  # whatever the estimator's own step
        self._timing = timing_of(model, slow, periods_s, SIGNALS)
        self._memory = new_memory()
        self._places = {name: i for i, name in enumerate(SIGNALS) if name in periods_s}
        self._at, self._rows = np.zeros(_MOST, np.int64), np.zeros((_MOST, len(SIGNALS)))

    @property
    def lookback_ns(self) -> int:
        """From a grid point back to the instant that is read there."""
        return self._timing.lookback

    def push(self, signal: str, t_ns: int, value: float) -> None:
        """One sample; what the estimator does not know is ignored."""
        place = self._places.get(signal)
        if place is not None:
            push(self._memory, self._timing, place, t_ns, value)

    def advance(self, t_ns: int) -> int:
        """A sync frame: how many rows are due."""
        return int(_advance(self._memory, self._timing, t_ns, self._at, self._rows))

    def rows(self, n: int) -> Iterator[tuple[int, list[float]]]:
        """(physical instant, values in the order of SIGNALS; NaN: missing, lost or bad)."""
        return zip(self._at[:n].tolist(), self._rows[:n].tolist(), strict=True)
