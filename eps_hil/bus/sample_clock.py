"""When a value was sampled, told by the sender's counter rather than by the receive stamp.

A receive stamp is late by whatever the sender's scheduler, the arbitration and the receiver's
driver added: mostly a constant, sometimes several milliseconds followed by a burst. The counter
says which cycle of the sender a frame belongs to, and the cycles are evenly spaced on the
sender's quartz. So instants lie on a line, offset + cycle * period * (1 + drift), and the line is
the *lower envelope* of the stamps: delay only ever adds, a frame is never early.

One clock serves all messages of one sender and one period, and each message is a *lane* on it
with its own counter. They are sampled in the same task; with a line of its own each, their
relative timing would wander by the noise of two estimates and carry the bus time between the
frames, and torque against speed is what the estimate is made of: 0.1 ms on a 7 Nm/s sweep is
2 N at the rack. A lane joins at the cycle nearest in time to the frame received last.

What can go wrong, and what happens:

* burst after a hiccup: cycles follow the counter, instants stay on the line;
* lost frames: the counter skips, the instant skips with it; a loss of more than the counter's
  modulus is seen because the largest skip that is not early is taken;
* drift: the slope of the envelope is tracked between the older and newer half of some 4 s,
  bounded to 300 ppm, and the envelope is taken over 0.5 s (at a period of 1 ms);
* a frame that would be early by more than half a period, a counter that cannot be, a silence
  that ended late, frames that stay late without catching up (the sender slipped its schedule):
  the clock restarts on that frame at once. It never slews.

An instant is at most the stamp plus 1 us per frame of a burst, and is strictly increasing per
message unless the stamps themselves go back by more than a period. It depends on nothing but the
sequence of (stamp, counter, lane): live and replayed frames give the same instants.
"""

from collections import deque
from typing import NamedTuple

MIN_STEP_NS = 1_000
_BLOCK = 64  # cycles whose lowest stamp stands for them
_ENVELOPE_BLOCKS = 8
_SLOPE_BLOCKS = 64
_SLOPE_MIN_BLOCKS = 16
_MAX_DRIFT = 300e-6
_LATE = 0.75  # of a period: further than a message of the same cycle can lie
_LATE_RUN = 16
_LATE_TOTAL = 128  # not one frame in time, though some caught up
_SILENCE_PERIODS = 20


class Instant(NamedTuple):
    """``t_ns``: when it was sampled; ``lost``: frames missing before it; ``restarted``."""

    t_ns: int
    lost: int = 0
    restarted: bool = False


class _Lane:
    """One message on the clock: its last counter, cycle, stamp and instant."""

    __slots__ = (
        "counter", "cycle", "joined", "late_first", "late_last", "late_run", "late_total",
        "repeated", "stamp", "t",
    )  # fmt: skip

    def __init__(self) -> None:
        self.joined = False
        self.counter = -1  # none seen yet
        self.cycle = self.stamp = 0
        self.t: int | None = None
        self.repeated = False
        self.late_total = self.late_run = 0
        self.late_first = self.late_last = 0


class SampleClock:
    """Sample instants from (receive stamp, counter) of one sender's messages of one period.

    ``period_ns``: the cycle time by the sender's quartz; ``counter_modulo``: where the counters
    wrap; ``silence_ns``: longest silence after which a late frame still counts as a hiccup
    (default 20 periods).
    """

    def __init__(
        self, period_ns: int, counter_modulo: int, *, silence_ns: int | None = None
    ) -> None:
        self.period_ns = period_ns
        self.counter_modulo = counter_modulo
        self.silence_ns = _SILENCE_PERIODS * period_ns if silence_ns is None else silence_ns
        self.restarts = 0
        self._lanes: dict[str, _Lane] = {}
        self._last: _Lane | None = None
        self._origin = 0
        self._slope = 0.0  # ns per cycle against the nominal period
        self._anchor, self._level = 0, 0
        self._block_start, self._low_cycle, self._low = 0, 0, 0
        self._lows: deque[tuple[int, int]] = deque(maxlen=_SLOPE_BLOCKS)

    @property
    def drift_ppm(self) -> float:
        """How much slower (+) than ours the sender's clock is taken to run."""
        return self._slope / self.period_ns * 1e6

    def instant(self, t_ns: int, counter: int, lane: str = "") -> Instant | None:
        """The sample instant of a frame stamped ``t_ns``; None for a repeated frame."""
        at = self._lanes.setdefault(lane, _Lane())
        skip = (counter - at.counter) % self.counter_modulo
        if not at.joined:
            return self._join(at, t_ns, counter, skip)
        elapsed = (t_ns + self.period_ns // 2 - self._due(at.cycle)) // self.period_ns
        if skip == 0 and (at.repeated or elapsed < self.counter_modulo):
            at.repeated = True
            return None
        at.repeated = False
        silence = t_ns - at.stamp
        if skip > elapsed:  # would be early
            return self._restart(at, t_ns, counter, skip, silence)
        cycles = skip + (elapsed - skip) // self.counter_modulo * self.counter_modulo
        late = t_ns - self._due(at.cycle + cycles)
        if self._slipped(at, late, silence):
            return self._restart(at, t_ns, counter, skip, silence)
        return Instant(self._place(at, t_ns, counter, at.cycle + cycles), cycles - 1)

    def expected(self, t_ns: int, lane: str = "") -> int:
        """The likely instant of a frame whose counter cannot be trusted (its CRC failed)."""
        at = self._lanes.setdefault(lane, _Lane())
        due = self._due(at.cycle + 1) if at.joined else t_ns
        return self._forward(at, t_ns, min(due, t_ns))

    def _due(self, cycle: int) -> int:
        line = self._level + self._slope * (cycle - self._anchor)
        return self._origin + cycle * self.period_ns + round(line)

    def _join(self, at: _Lane, t_ns: int, counter: int, skip: int) -> Instant | None:
        """Enter beside the other lanes: at the cycle nearest to the frame received last."""
        first = at.counter < 0
        if skip == 0 and not first:
            return None
        silence = 0 if first else t_ns - at.stamp
        last = self._last
        since = 0 if last is None else t_ns - last.stamp
        if last is None or not 0 <= since <= self.silence_ns:
            return self._restart(at, t_ns, counter, 1 if first else skip, silence)
        cycle = last.cycle + (since + self.period_ns // 2) // self.period_ns
        lost = 0 if first else self._held(skip, silence)
        return Instant(self._place(at, t_ns, counter, cycle), lost)

    def _restart(self, at: _Lane, t_ns: int, counter: int, skip: int, silence: int) -> Instant:
        """A new line through this frame; the drift is the quartz's and stays."""
        again = self._last is not None
        for lane in self._lanes.values():
            lane.joined = False
            lane.late_total = lane.late_run = 0
        self._origin, self._anchor, self._level = t_ns, 0, 0
        self._block_start, self._low_cycle, self._low = 0, 0, 0
        self._lows.clear()
        self.restarts += again
        return Instant(self._place(at, t_ns, counter, 0), self._held(skip, silence), again)

    def _held(self, skip: int, silence: int) -> int:
        """Frames lost by a skip; 0 if the silence is too short for it: the sender began anew."""
        held = skip > 0 and (skip - 1) * self.period_ns <= silence + self.silence_ns
        return skip - 1 if held else 0

    def _place(self, at: _Lane, t_ns: int, counter: int, cycle: int) -> int:
        at.joined, at.counter, at.cycle, at.stamp = True, counter, cycle, t_ns
        self._last = at
        residual = t_ns - self._origin - cycle * self.period_ns
        self._remember(cycle, residual)
        if residual < self._level + self._slope * (cycle - self._anchor):
            self._anchor, self._level = cycle, residual
        return self._forward(at, t_ns, self._due(cycle))

    def _forward(self, at: _Lane, t_ns: int, due: int) -> int:
        """Strictly after the lane's last instant, unless the stamps themselves went back."""
        if at.t is not None and due <= at.t and at.t + MIN_STEP_NS <= t_ns + self.period_ns:
            due = at.t + MIN_STEP_NS
        at.t = due
        return due

    def _slipped(self, at: _Lane, late: int, silence: int) -> bool:
        """Whether lateness is no hiccup any more: after a silence, or without catching up."""
        if late <= _LATE * self.period_ns:
            at.late_total = at.late_run = 0
            return False
        if silence > self.silence_ns:
            return True
        fell = at.late_last - late > self.period_ns // 2  # a burst: it is catching up
        if at.late_run == 0 or fell:
            at.late_run, at.late_first = 0, late
        at.late_run += 1
        at.late_total += 1
        at.late_last = late
        if at.late_total >= _LATE_TOTAL:
            return True
        if at.late_run < _LATE_RUN:
            return False
        at.late_run = 0
        return late > at.late_first - self.period_ns

    def _remember(self, cycle: int, residual: int) -> None:
        if cycle - self._block_start >= _BLOCK:
            self._lows.append((self._low_cycle, self._low))
            self._refit()
            self._block_start, self._low_cycle, self._low = cycle, cycle, residual
        elif residual - self._low < self._slope * (cycle - self._low_cycle):
            self._low_cycle, self._low = cycle, residual

    def _refit(self) -> None:
        lows = list(self._lows)
        if len(lows) >= _SLOPE_MIN_BLOCKS:
            old, new = self._lowest(lows[: len(lows) // 2]), self._lowest(lows[len(lows) // 2 :])
            limit = _MAX_DRIFT * self.period_ns
            slope = (new[1] - old[1]) / (new[0] - old[0])
            self._slope += 0.5 * (max(-limit, min(limit, slope)) - self._slope)
        self._anchor, self._level = self._lowest(lows[-_ENVELOPE_BLOCKS:])

    def _lowest(self, lows: list[tuple[int, int]]) -> tuple[int, int]:
        return min(lows, key=lambda low: low[1] - self._slope * low[0])
