"""Keeping time: absolute deadlines, and honest numbers about how late it was."""

import gc
import os
import time
from dataclasses import dataclass

import numpy as np

MILLISECOND_NS = 1_000_000
CATCH_UP_MS = 20
"""A bus would have carried the frames of a short delay; after a longer one time starts anew."""

_BINS = 100_000


@dataclass(frozen=True, slots=True)
class Lateness:
    """Wake-ups against their deadlines, in µs."""

    p50_us: float
    p99_us: float
    max_us: float


class Pacer:
    """Absolute deadlines ``period_ns`` apart on the monotonic clock."""

    def __init__(self, period_ns: int = MILLISECOND_NS) -> None:
        self._period_ns = period_ns
        self._next_ns = time.monotonic_ns() + period_ns
        self._bins = np.zeros(_BINS, dtype=np.int64)
        self._worst_ns = 0
        self.overruns = 0
        self.caught_up = 0

    def wait(self) -> int:
        """Sleep to the next deadline; how many periods are due now (1, or more when late).

        Later than ``CATCH_UP_MS``: one overrun is counted and the deadlines start from now.
        """
        rest_ns = self._next_ns - time.monotonic_ns()
        if rest_ns > 0:
            time.sleep(rest_ns * 1e-9)
        late_ns = max(time.monotonic_ns() - self._next_ns, 0)
        self._worst_ns = max(self._worst_ns, late_ns)
        self._bins[min(late_ns // 1000, _BINS - 1)] += 1
        due = 1 + late_ns // self._period_ns
        if late_ns >= CATCH_UP_MS * MILLISECOND_NS:
            self.overruns += 1
            self._next_ns = time.monotonic_ns() + self._period_ns
            return 1
        self.caught_up += due - 1
        self._next_ns += due * self._period_ns
        return int(due)

    @property
    def lateness(self) -> Lateness:
        """Percentiles over all wake-ups so far."""
        total = np.cumsum(self._bins)
        if total[-1] == 0:
            return Lateness(0.0, 0.0, 0.0)
        at = [float(np.searchsorted(total, share * total[-1])) for share in (0.5, 0.99)]
        return Lateness(at[0], at[1], self._worst_ns / 1000)


def settle(fifo: bool) -> str:
    """Move what was built so far out of the garbage collector's sight, and ask for SCHED_FIFO.

    Returns what was granted, in words. Children do not inherit the priority.
    """
    gc.collect()
    gc.freeze()
    if not fifo:
        return "normal scheduling"
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(20))
    except (AttributeError, OSError):
        return "normal scheduling (SCHED_FIFO is not permitted here)"
    return "SCHED_FIFO"
