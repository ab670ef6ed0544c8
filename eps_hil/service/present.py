"""The present by the clock of the frames' stamps, and whether that clock was set meanwhile.

Receive stamps are of CLOCK_REALTIME, which somebody may set; how old an answer is can then not be
said by it. CLOCK_MONOTONIC never jumps and follows the same slewing, so the two part only when
the first one is set.
"""

import time
from collections.abc import Callable

UNKNOWN = 0
"""Instead of a time that nobody knows; by it, every answer is stale."""
_STEP_NS = 1_000_000
_SHARE = 1_000  # of the time between two looks: reading two clocks takes time too


class Present:
    """Asked for the time whenever an answer is made; ``steps``: how often the clock was set."""

    def __init__(
        self,
        wall: Callable[[], int] = time.time_ns,
        steady: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._wall, self._steady = wall, steady
        self._wall_ns, self._steady_ns = wall(), steady()
        self.steps = 0

    def now_ns(self) -> int:
        """ns since the epoch; ``UNKNOWN`` where the clock was set since the last look."""
        wall_ns, steady_ns = self._wall(), self._steady()
        spent_ns = steady_ns - self._steady_ns
        moved_ns = wall_ns - self._wall_ns - spent_ns
        self._wall_ns, self._steady_ns = wall_ns, steady_ns
        if abs(moved_ns) > _STEP_NS + spent_ns // _SHARE:
            self.steps += 1
            return UNKNOWN
        return wall_ns
