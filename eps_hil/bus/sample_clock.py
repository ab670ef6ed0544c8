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
* a frame that would be early by more than half a period, a silence that ended late, frames that
  stay late without catching up (the sender slipped its schedule): the clock restarts on that
  frame at once. It never slews. (Frames of *all* messages that wait equally long, all the time,
  look like those of a sender that paused: no counter tells a gateway's constant delay);
* late for good again within 0.8 s of such a slip: frames that wait behind others on a full bus are
  late time and again, by more or by less. They keep their instants on the line, and are not trusted
  from two periods on, for 0.8 s; or until 32 in a row are late by the same within a quarter of a
  period, as those of a sender that slipped are;
* a lane that is late while another is in time: the lanes' counters stay in one relation unless a
  message was interrupted, so it is this lane's frames that wait. They keep the instants that their
  counter says, and are not *trusted* from four periods on. A relation that stays changed for 0.8 s
  is taken for a message that was interrupted;
* a counter that cannot be: not trusted, until eight frames in a row follow each other;
* a counter that jumped back or stood still: frames of counters that were there a moment ago have
  no instant, but where they came at the rate, what follows them is in time.

An instant is at most the stamp plus 1 us per frame of a burst, and is strictly increasing per
message unless the stamps themselves go back by more than a period. It depends on nothing but the
sequence of (stamp, counter, lane): live and replayed frames give the same instants.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from eps_hil.bus.lane import Instant, Lane

__all__ = ["MIN_STEP_NS", "Instant", "SampleClock"]

# frozen into compiled code (instants.py)
MIN_STEP_NS = 1_000
BLOCK = 64  # cycles (milliseconds, where those are longer) whose lowest stamp stands for them
ENVELOPE_BLOCKS = 8
SLOPE_BLOCKS = 64
SLOPE_MIN_BLOCKS = 16
MAX_DRIFT = 300e-6
LATE = 0.75  # of a period: further than a message of the same cycle can lie
_LATE_RUN = 16
_LATE_TOTAL = 128  # not one frame in time, though some caught up
_SILENCE_PERIODS = 20
_DOUBT_NS = 800_000_000  # how long a lane that alone is late is taken to wait
_PASSED_NS = 60_000_000  # the same where it did nothing, and another came that may have waited
_YOUNG_NS = (
    2_000_000_000  # so long after it was guessed by time a relation of counters may be wrong
)
_WAITED = 3.5  # periods of lateness from which that matters
_SLIPPED = 2.0  # the same where all are late again, soon after their sender slipped
_STEADY = 0.25  # periods within which lateness stays if frames do not wait
_STEADY_RUN = 32
_RELATED = 64  # frames in time after which a lane's counter belongs to the line
_IN_A_ROW = 8
_MS = 1_000_000
_instant = partial(tuple.__new__, Instant)


def _heard(at: Lane) -> int:
    """Stamp of a lane's newest frame, whether it has a place on the line or none."""
    return at.strayed if at.in_a_row else at.stamp


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
        # What is in periods below is in milliseconds for a sender that is faster than that: how
        # late a frame can be is a matter of schedulers and drivers, not of its rate.
        self._scale = max(1, round(_MS / period_ns))
        self._unit_ns = self._scale * period_ns
        usual = _SILENCE_PERIODS * self._unit_ns
        self.silence_ns = usual if silence_ns is None else silence_ns
        self.restarts = 0
        self.moved_ns = 0
        """By how much the line went to later instants, in all: time itself seemed to jump."""
        self._lanes: dict[str, Lane] = {}
        self.last: Lane | None = None
        self._paused = False  # whether the sender was silent before the line began
        self._slip = 0  # stamp at which it last went on with frames that were late for good
        self._later = (0, 0)  # stamp at which the line went to later instants, and by how much
        self._origin = 0
        self._slope = 0.0  # ns per cycle against the nominal period
        self._anchor, self._level = 0, 0
        self._block_start, self._low_cycle, self._low = 0, 0, 0
        self._block = BLOCK * self._scale
        self.lows: deque[tuple[int, int]] = deque(maxlen=SLOPE_BLOCKS)

    @property
    def drift_ppm(self) -> float:
        """How much slower (+) than ours the sender's clock is taken to run."""
        return self._slope / self.period_ns * 1e6

    def line(self) -> dict[str, int | float]:
        """What :meth:`instant` goes on from, beside the lanes and the lowest stamps."""
        return {
            "scale": self._scale, "unit": self._unit_ns, "origin": self._origin,
            "slope": self._slope, "anchor": self._anchor, "level": self._level,
            "block_start": self._block_start, "low_cycle": self._low_cycle, "low": self._low,
            "moved": self.moved_ns,
        }  # fmt: skip

    def go_on(self, line: Mapping[str, Any], lows: Sequence[tuple[int, int]], last: str) -> None:
        """Go on from there, after frames that were placed on the line elsewhere (instants.py)."""
        self._origin, self._slope = line["origin"], line["slope"]
        self._anchor, self._level = line["anchor"], line["level"]
        self._block_start, self._low_cycle = line["block_start"], line["low_cycle"]
        self._low, self.moved_ns = line["low"], line["moved"]
        self.lows.clear()
        self.lows.extend(lows)
        if self.last is not None:
            self.last = self.lane(last)

    def has(self, name: str) -> bool:
        """Whether a frame of that message came."""
        return name in self._lanes

    def lane(self, name: str) -> Lane:
        """The message of that name, from its first frame on."""
        return self._lanes.setdefault(name, Lane())

    def instant(self, t_ns: int, counter: int, lane: str = "") -> Instant | None:
        """The sample instant of a frame stamped ``t_ns``; None for a repeated frame."""
        at = self._lanes.get(lane)
        if at is None:
            at = self._lanes.setdefault(lane, Lane())
        modulo, period = self.counter_modulo, self.period_ns
        skip = (counter - at.counter) % modulo
        if not at.joined:
            return self._join(at, t_ns, counter, skip)
        early = t_ns + period // 2 - self._due(at.cycle)
        elapsed = early // period
        if skip == 0 and (at.repeated or elapsed < modulo):
            at.repeated = True
            return None
        at.repeated = False
        if skip > elapsed:  # would be early
            return self._early(at, t_ns, counter, skip)
        cycles = skip + (elapsed - skip) // modulo * modulo
        late = early - period // 2 - cycles * period
        silence = 0 if late <= LATE * self._unit_ns else t_ns - _heard(at)
        at.in_a_row = 0
        if late <= LATE * self._unit_ns:
            at.late_total = at.late_run = 0
            at.late_last = 0
            at.behind_since = None
            at.in_time += 1
        elif self._in_their_place(at, t_ns, counter, late):
            at.joined, at.phase, at.behind_since = False, None, None
            return self._join(at, t_ns, counter, skip)
        elif self._slipped(at, late, silence):
            return self._late(at, t_ns, counter, skip, cycles, late)
        due = self._place(at, t_ns, counter, at.cycle + cycles)
        return _instant((due, cycles - 1, False, True))  # as almost always

    def again(self, t_ns: int, counter: int, lane: str = "", *, other_data: bool = False) -> None:
        """A frame came whose counter was there a moment ago, also for ``other_data``: no instant.

        At the rate, of counters that follow each other or of one that stands still over other
        data, such frames are the message's own.
        """
        at = self._lanes.setdefault(lane, Lane())
        still = counter == at.again and other_data
        follows = still or counter == (at.again + 1) % self.counter_modulo
        at.again_run = at.again_run + 1 if follows and self._at_the_rate(at, t_ns) else 1
        at.again, at.again_stamp, at.again_still = counter, t_ns, int(still)

    def _at_the_rate(self, at: Lane, t_ns: int) -> bool:
        """Whether it comes a period after one that was there before, and none between."""
        since = t_ns - at.again_stamp
        return self.period_ns // 4 < since < 2 * self._unit_ns and at.stamp <= at.again_stamp

    def _in_their_place(self, at: Lane, t_ns: int, counter: int, late: int) -> bool:
        """Whether a late frame is in time, and its counter jumped back, or had stood still.

        Then the counters that were there before came in its place, at the rate, and fill at least
        two thirds of the time that it seems to be late.
        """
        follows = at.again_still or counter == (at.again + 1) % self.counter_modulo
        filled = at.again_run > 1 and 3 * at.again_run * self.period_ns >= 2 * late
        return bool(follows and filled and self._at_the_rate(at, t_ns))

    def expected(self, t_ns: int, lane: str = "") -> int:
        """The likely instant of a frame whose counter cannot be trusted (its CRC failed)."""
        at = self._lanes.setdefault(lane, Lane())
        due = self._due(at.cycle + 1) if at.joined else t_ns
        return self._forward(at, t_ns, min(due, t_ns))

    def _due(self, cycle: int) -> int:
        line = self._level + self._slope * (cycle - self._anchor)
        return self._origin + cycle * self.period_ns + round(line)

    def _join(self, at: Lane, t_ns: int, counter: int, skip: int) -> Instant | None:
        """Enter beside the other lanes: by the counter, else at the cycle nearest in time."""
        first = at.counter < 0
        if skip == 0 and not first:
            return None
        silence = 0 if first else t_ns - at.stamp
        last = self.last
        since = 0 if last is None else t_ns - last.stamp
        if last is None or not 0 <= since <= self.silence_ns:
            return self._restart(at, t_ns, counter, 1 if first else skip, silence)
        cycle = last.cycle + (since + self.period_ns // 2) // self.period_ns
        if silence > self.silence_ns and (counter == 0 or self._was_of_two(at, t_ns)):
            at.phase = None  # it began anew, whatever it was before
        if at.phase is not None:
            half = self.counter_modulo // 2
            ahead = (counter - at.phase - cycle + half) % self.counter_modulo - half
            if ahead < -1 and self._kept_pace(at, t_ns, skip):
                ahead = 0  # the other was before its time: it waits no more, or its counter jumped
            if ahead > 1:  # by its counter the line is that of frames that waited
                return self._restart(at, t_ns, counter, skip, silence)
            at.phase = None
            waits = ahead < -_WAITED * self._scale
            if waits:
                at.behind_since, at.late_last = t_ns, -ahead * self.period_ns
            cycle += 0 if self._paused and ahead >= -1 else ahead
        else:
            waits = False
            at.near_since = t_ns
        lost = 0 if first else self._held(skip, silence)
        return Instant(self._place(at, t_ns, counter, cycle), lost, trusted=not waits)

    def _was_of_two(self, at: Lane, t_ns: int) -> bool:
        """Whether it was silent, and before that had counters of two senders, by turns.

        Nobody knows which of them goes on, and so not by its counter whether it waits.
        """
        return t_ns - at.stamp > self.silence_ns and 0 < at.stamp - at.strayed <= self._unit_ns

    def _kept_pace(self, at: Lane, t_ns: int, skip: int) -> bool:
        """Whether it counted on as time went since its last frame, and did not slip of late."""
        elapsed = (t_ns - at.stamp + self.period_ns // 2) // self.period_ns
        off = (skip - elapsed + 1) % self.counter_modulo - 1
        slipped = at.slipped_at > 0 and 0 <= t_ns - at.slipped_at <= _DOUBT_NS
        return abs(off) <= 1 and at.in_time >= _RELATED and not slipped

    def _early(self, at: Lane, t_ns: int, counter: int, skip: int) -> Instant:
        """A frame before its time: the stamps' clock was set, or the counter cannot be."""
        silence = t_ns - _heard(at)
        since, by = self._later  # it may be the line of frames that waited: others did, too
        burst = 0 <= t_ns - since <= by and self._due(at.cycle + skip) - t_ns <= by
        alone = self._caught_up(at, t_ns) and self._others_in_time(at, t_ns)
        if (skip == 1 and not alone) or burst or not 0 <= silence <= self.silence_ns:
            found = self._restart(at, t_ns, counter, skip, silence)
            self._be_patient(at, t_ns)
            return found
        follows = counter == (at.stray + 1) % self.counter_modulo
        at.in_a_row = at.in_a_row + 1 if follows and at.in_a_row else 1
        at.stray = counter
        if at.in_a_row == 1:
            at.row_since = t_ns
        if at.in_a_row < _IN_A_ROW:
            at.strayed = t_ns
            return Instant(self._forward(at, t_ns, t_ns), trusted=False)
        at.in_a_row = 0
        waited = 2 * (t_ns - at.row_since) < _IN_A_ROW * self.period_ns
        if waited and alone:  # still a burst: by time it has no place yet
            at.strayed, at.in_a_row, at.row_since = t_ns, 1, t_ns
            return Instant(self._forward(at, t_ns, t_ns), trusted=False)
        if waited or not self._others_in_time(at, t_ns):
            return self._restart(at, t_ns, counter, skip, silence)
        at.joined, at.phase = False, None
        return self._join(at, t_ns, counter, skip) or Instant(t_ns, trusted=False)

    def _caught_up(self, at: Lane, t_ns: int) -> bool:
        """Whether its frames waited until a moment ago: what comes now may be of that burst."""
        return at.waited_at > 0 and 0 <= t_ns - at.waited_at <= self.silence_ns

    def _be_patient(self, at: Lane, t_ns: int) -> None:
        """For how long others are taken to wait where ``at`` was too early for the line.

        If the relation of the counters is known, they do wait. If it was guessed by time not long
        ago, it was ``at`` that waited then, and they are in time.
        """
        for lane in self._lanes.values():
            young = min(t_ns - at.near_since, t_ns - lane.near_since) < _YOUNG_NS
            lane.patience = _PASSED_NS if young else _DOUBT_NS
            lane.passed = t_ns

    def _late(
        self, at: Lane, t_ns: int, counter: int, skip: int, cycles: int, late: int
    ) -> Instant:
        """Late without catching up: the sender's schedule slipped, or this lane's frames wait."""
        at.slipped_at = t_ns
        if self._others_in_time(at, t_ns):
            if self._was_of_two(at, t_ns):
                at.joined, at.phase, at.behind_since = False, None, None
                return self._join(at, t_ns, counter, skip) or Instant(t_ns, trusted=False)
            at.waited_at = t_ns
            if at.behind_since is None or not t_ns - at.behind_since > at.patience:
                if at.behind_since is None:
                    at.behind_since = t_ns
                    if not 0 <= t_ns - at.passed <= _DOUBT_NS:
                        at.patience = _DOUBT_NS
                t = self._place(at, t_ns, counter, at.cycle + cycles)
                return Instant(t, cycles - 1, trusted=late < _WAITED * self._unit_ns)
            at.joined, at.phase, at.behind_since = False, None, None
            return self._join(at, t_ns, counter, skip) or Instant(t_ns, trusted=False)
        silence = t_ns - at.stamp
        far = max(silence - self.silence_ns, late - _WAITED * self._unit_ns) > 0
        if not far and self._slips_again(at, t_ns) and not self._is_steady(at, late):
            if at.behind_since is None:
                at.behind_since = t_ns
            t = self._place(at, t_ns, counter, at.cycle + cycles)
            return Instant(t, cycles - 1, trusted=late < _SLIPPED * self._unit_ns)
        self._slip = t_ns
        return self._restart(at, t_ns, counter, skip, silence, max(late - at.late_low, 0))

    def _slips_again(self, at: Lane, t_ns: int) -> bool:
        """Whether it is late for good again, soon after a slip, and has not been so for long.

        A sender that pauses slips once, or far. Frames that wait behind others on a full bus are
        late time and again, by more or by less.
        """
        since = self._slip if at.behind_since is None else at.behind_since
        return self._slip > 0 and 0 <= t_ns - since <= _DOUBT_NS

    def _is_steady(self, at: Lane, late: int) -> bool:
        """Whether a run of frames is late by one and the same: they do not wait, it slipped."""
        low, high = min(at.steady_low, late), max(at.steady_high, late)
        if at.behind_since is None or high - low > _STEADY * self._unit_ns:
            at.steady_run, low, high = 0, late, late
        at.steady_run, at.steady_low, at.steady_high = at.steady_run + 1, low, high
        if at.steady_run < _STEADY_RUN * self._scale:
            return False
        at.late_low = low
        return True

    def _others_in_time(self, at: Lane, t_ns: int) -> bool:
        """Whether another lane's newest frame was in time, and is new."""
        return any(
            lane is not at
            and lane.joined
            and lane.in_time >= _RELATED
            and lane.late_last <= LATE * self._unit_ns
            and 0 <= t_ns - lane.stamp <= self.silence_ns
            for lane in self._lanes.values()
        )

    def _restart(
        self, at: Lane, t_ns: int, counter: int, skip: int, silence: int, waited: int = 0
    ) -> Instant:
        """A new line through this frame, less what it waited; the drift is kept.

        A sender that counts from 0 after a silence began anew: what its messages were is over.
        """
        if counter == 0 and skip > 1 and silence > self.silence_ns:
            at.joined, at.phase, skip, waited = False, None, 1, 0
        last = self.last
        again = last is not None
        if at.joined:
            moved = t_ns - waited - self._due(at.cycle + max(skip, 1))
            self.moved_ns += moved
            since, by = self._later
            if moved > 0 or not 0 <= t_ns - since <= by:
                since, by = t_ns, 0
            self._later = since, by + moved
        self._paused = last is None or t_ns - _heard(last) > self.silence_ns
        phase = at.counter - at.cycle if at.joined else at.phase
        known = phase is not None and at.in_time >= _RELATED
        moved = counter - (phase or 0)
        if again and skip > 1 and not self._held(skip, max(silence, 0)):
            known = False  # no counter that goes on: it tells nothing of the others'
            for lane in self._lanes.values():
                lane.in_time = 0
        for lane in self._lanes.values():
            if lane is at or not known:
                lane.phase = None
            elif lane.joined and lane.in_time >= _RELATED:
                lane.phase = lane.counter - lane.cycle + moved
            elif lane.phase is not None:
                lane.phase += moved
            lane.joined = False
            if lane.late_last > LATE * self._unit_ns:
                lane.slipped_at = lane.stamp
            lane.late_total = lane.late_run = lane.late_last = 0
            lane.behind_since, lane.patience = None, _DOUBT_NS
            if silence > self.silence_ns:  # the sender may have begun anew, each counter by itself
                lane.near_since = t_ns
        self._origin, self._anchor, self._level = t_ns - waited, 0, 0
        self._block_start, self._low_cycle, self._low = 0, 0, 0
        self.lows.clear()
        self.restarts += again
        return Instant(self._place(at, t_ns, counter, 0), self._held(skip, silence), again)

    def _held(self, skip: int, silence: int) -> int:
        """Frames lost by a skip; 0 if the silence is too short for it: the sender began anew."""
        held = skip > 0 and (skip - 1) * self.period_ns <= silence + self.silence_ns
        return skip - 1 if held else 0

    def _place(self, at: Lane, t_ns: int, counter: int, cycle: int) -> int:
        at.joined, at.counter, at.cycle, at.stamp = True, counter, cycle, t_ns
        self.last = at
        due = self._origin + cycle * self.period_ns
        residual = t_ns - due
        if cycle - self._block_start >= self._block:
            self._next_block(cycle, residual)
        elif residual - self._low < self._slope * (cycle - self._low_cycle):
            self._low_cycle, self._low = cycle, residual
        line = self._slope * (cycle - self._anchor)
        lower = residual - self._level - line
        if lower < 0.0:
            self._anchor, self._level, line = cycle, residual, 0.0
            self.moved_ns += round(lower)
        due += round(self._level + line)
        if at.t is not None and due <= at.t:
            return self._forward(at, t_ns, due)
        at.t = due
        return due

    def _forward(self, at: Lane, t_ns: int, due: int) -> int:
        """Strictly after the lane's last instant, unless the stamps themselves went back."""
        if at.t is not None and due <= at.t and at.t + MIN_STEP_NS <= t_ns + self.period_ns:
            due = at.t + MIN_STEP_NS
        at.t = due
        return due

    def _slipped(self, at: Lane, late: int, silence: int) -> bool:
        """Whether lateness is no hiccup any more: after a silence, or without catching up."""
        if at.behind_since is not None:
            at.late_last, at.late_low = late, min(at.late_low, late)
            return True
        if silence > self.silence_ns:
            at.late_low = late
            return True
        fell = at.late_last - late > self._unit_ns // 2  # a burst: it is catching up
        if at.late_run == 0 or fell:
            at.late_run, at.late_first, at.late_low = 0, late, late
        at.late_low = min(at.late_low, late)
        at.late_run += 1
        at.late_total += 1
        at.late_last = late
        if at.late_total >= _LATE_TOTAL * self._scale:
            return True
        if at.late_run < _LATE_RUN * self._scale:
            return False
        at.late_run = 0
        return late > at.late_first - self._unit_ns

    def _next_block(self, cycle: int, residual: int) -> None:
        self.lows.append((self._low_cycle, self._low))
        self._refit()
        self._block_start, self._low_cycle, self._low = cycle, cycle, residual

    def _refit(self) -> None:
        lows = list(self.lows)
        if len(lows) >= SLOPE_MIN_BLOCKS:
            old, new = self._lowest(lows[: len(lows) // 2]), self._lowest(lows[len(lows) // 2 :])
            limit = MAX_DRIFT * self.period_ns
            slope = (new[1] - old[1]) / (new[0] - old[0])
            self._slope += 0.5 * (max(-limit, min(limit, slope)) - self._slope)
        self._anchor, self._level = self._lowest(lows[-ENVELOPE_BLOCKS:])

    def _lowest(self, lows: list[tuple[int, int]]) -> tuple[int, int]:
        return min(lows, key=lambda low: low[1] - self._slope * low[0])
