"""What a :class:`~eps_hil.bus.sample_clock.SampleClock` says of a frame, and keeps of a message."""

from typing import NamedTuple


class Instant(NamedTuple):
    """``t_ns``: when it was sampled; ``lost``: frames missing before it; ``restarted``.

    ``trusted``: False where that instant is a guess, and the frame perhaps another sender's.
    """

    t_ns: int
    lost: int = 0
    restarted: bool = False
    trusted: bool = True


class Lane:
    """One message on the clock: last counter, cycle and stamp that had a place on it, instant."""

    __slots__ = (
        "again", "again_run", "again_stamp", "again_still", "behind_since", "counter", "cycle",
        "in_a_row", "in_time", "joined", "late_first", "late_last", "late_low", "late_run",
        "late_total", "near_since", "passed", "patience", "phase", "repeated", "row_since",
        "slipped_at", "stamp", "steady_high", "steady_low", "steady_run", "stray", "strayed", "t",
        "waited_at",
    )  # fmt: skip

    def __init__(self) -> None:
        self.joined = False
        self.counter = -1  # none seen yet
        self.cycle = self.stamp = 0
        self.t: int | None = None
        self.repeated = False
        self.late_total = self.late_run = 0
        self.late_first = self.late_last = 0
        self.late_low = 0  # the least late of those in the run
        self.in_time = 0  # frames in time since it joined
        self.phase: int | None = None  # counter less cycle, where the line was left with it known
        self.behind_since: int | None = None  # stamp since when it alone is late
        self.patience = 0  # for how long it is then taken to wait
        self.passed = 0  # stamp since when another is earlier than the line was
        self.near_since = 0  # stamp since when its relation to the others is a guess by time
        self.stray = -1  # the last counter that could not be
        self.strayed = 0  # its stamp
        self.again = self.again_stamp = 0  # the last counter that was there before, and its stamp
        self.again_run = 0  # how many of these came one after the other
        self.again_still = 0  # whether (0 or 1) that counter stands still over other data
        self.slipped_at = 0  # stamp of the last frame that was late for good
        self.steady_run = 0  # how many of those in a row were late by one and the same
        self.steady_low = self.steady_high = 0
        self.waited_at = 0  # stamp of the last frame that waited while others did not
        self.in_a_row = 0
        self.row_since = 0  # stamp of the first of these
