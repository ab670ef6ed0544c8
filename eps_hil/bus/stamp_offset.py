"""Stamps of a device's clock, moved onto the system's epoch for as long as the run lasts.

A CAN adapter stamps by a crystal of its own. One offset, taken once, is 6 ms off after a minute at
100 ppm, and an estimate that is timed by it is stale. So the offset is followed: no frame arrives
before it was stamped, hence the lower envelope of arrival minus stamp over the last seconds is the
offset plus the quickest way through driver and bus. It is followed down at once, since too large
an offset makes frames look younger than they are, and up at a limited rate, since a busy second
in which every frame waited looks the same as a slow crystal.
"""

from collections import deque

_BLOCK_NS = 250_000_000
_BLOCKS = 8
_SLEW = 500e-6
"""Of the time spent: faster than any crystal drifts, slower than a queue builds up."""
_SLEW_SPAN_NS = 100_000_000
_AHEAD_NS = 5_000_000
"""A frame that is so much younger than it can be: the device's clock was set."""
_BACK_NS = 100_000_000
"""Frames of two channels may come out of order; by more, the device's clock began anew."""
_SAME_CLOCK_NS = 86_400_000_000_000
_SAME_NS = 5_000_000
"""Where no frame of the last seconds comes within it, "epoch" stamps are not of our clock."""
_EPOCH_MOVED_NS = 1_000_000


class StampOffset:
    """One device's clock. All times in ns; no clock of its own.

    Stamps on the epoch (within a day) are taken as they are, with the kernel's precision, until
    their lower envelope shows that another clock made them.
    """

    def __init__(self) -> None:
        self.followed = False
        """Whether an offset is being followed; else stamps are taken as they are."""
        self._offset_ns: float | None = None
        self._blocks: deque[float] = deque(maxlen=_BLOCKS)
        self._least_ns = float("inf")
        self._block_at = (0, 0)
        self._last_stamp_ns = self._last_steady_ns = 0
        self._epoch_ns = 0

    def on_epoch(self, stamp_ns: int, wall_ns: int, steady_ns: int) -> int:
        """The instant of a frame stamped ``stamp_ns``, by the system's wall clock.

        ``wall_ns``, ``steady_ns``: CLOCK_REALTIME and CLOCK_MONOTONIC when the driver gave it.
        """
        if self._offset_ns is None:
            self._epoch_ns = wall_ns - steady_ns
            self.followed = abs(wall_ns - stamp_ns) > _SAME_CLOCK_NS
            self._anchor(stamp_ns, steady_ns)
        if abs(wall_ns - steady_ns - self._epoch_ns) > _EPOCH_MOVED_NS:
            self._epoch_ns = wall_ns - steady_ns  # somebody set the wall clock
        waited_ns = (steady_ns if self.followed else wall_ns) - stamp_ns
        if self.followed:
            self._follow(stamp_ns, steady_ns, waited_ns)
        self._gather(stamp_ns, steady_ns, waited_ns)
        self._last_stamp_ns, self._last_steady_ns = stamp_ns, steady_ns
        if not self.followed:
            return stamp_ns
        return stamp_ns + round(self._offset_ns or 0.0) + self._epoch_ns

    def _anchor(self, stamp_ns: int, steady_ns: int) -> None:
        self._offset_ns = float(steady_ns - stamp_ns)
        self._blocks.clear()
        self._begin_block(stamp_ns, steady_ns)
        self._last_stamp_ns, self._last_steady_ns = stamp_ns, steady_ns

    def _follow(self, stamp_ns: int, steady_ns: int, waited_ns: int) -> None:
        offset_ns = self._offset_ns or 0.0
        if waited_ns < offset_ns - _AHEAD_NS or stamp_ns < self._last_stamp_ns - _BACK_NS:
            self._anchor(stamp_ns, steady_ns)
            return
        if self._blocks:
            room_ns = min(self._blocks) - offset_ns
            spent_ns = min(steady_ns - self._last_steady_ns, _SLEW_SPAN_NS)
            self._offset_ns = offset_ns + min(room_ns, _SLEW * spent_ns)

    def _gather(self, stamp_ns: int, steady_ns: int, waited_ns: int) -> None:
        """A block lasts by both clocks: a burst that waited is no block, whatever it spans."""
        self._least_ns = min(self._least_ns, waited_ns)
        spent_ns = min(stamp_ns - self._block_at[0], steady_ns - self._block_at[1])
        if spent_ns < _BLOCK_NS:
            return
        self._blocks.append(self._least_ns)
        self._begin_block(stamp_ns, steady_ns)
        if self.followed or len(self._blocks) < _BLOCKS:
            return
        least_ns = min(self._blocks)
        if least_ns > _SAME_NS or max(self._blocks) < -_SAME_NS:
            self.followed = True
            self._anchor(stamp_ns, steady_ns)
            self._offset_ns = least_ns - self._epoch_ns

    def _begin_block(self, stamp_ns: int, steady_ns: int) -> None:
        self._least_ns, self._block_at = float("inf"), (stamp_ns, steady_ns)
