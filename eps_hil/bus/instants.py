"""Sample instants of all frames of a log at once: counters, repeated frames, second senders.

What :class:`~eps_hil.bus.message_decoder.MessageDecoder` does frame by frame, compiled, as long
as a frame comes as almost all do. The first one that does not (a message that begins, a frame that
is early or late) is handed to the :class:`~eps_hil.bus.sample_clock.SampleClock` itself, so what is
unusual is written in one place.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.bus.sample_clock import (
    BLOCK,
    ENVELOPE_BLOCKS,
    LATE,
    MAX_DRIFT,
    MIN_STEP_NS,
    SLOPE_BLOCKS,
    SLOPE_MIN_BLOCKS,
)
from eps_hil.compiled import kernel

GOOD, UNTRUSTED, REPEATED, SECOND_SENDER, BAD = range(5)
"""What a frame turned out to be. Bad: its CRC or length, which is told before."""
_STAMP_NS = 1_000
_STRAIGHT_NS = 1_000_000
_DONE = -1

Ints = npt.NDArray[np.int64]

PLAIN = (
    "counter", "cycle", "stamp", "late_total", "late_run", "late_last", "in_time", "in_a_row",
    "again", "again_run", "again_stamp", "again_still",
)  # fmt: skip
"""What is kept of a message as ``Lane`` keeps it, too."""
LANE = np.dtype(
    [
        (name, "i8")
        for name in (
            *PLAIN, "joined", "repeated", "has_t", "t", "has_behind", "behind_since",
            "has_last", "last_ns",
        )
    ]
)  # fmt: skip
LINE = np.dtype(
    [
        (name, "i8")
        for name in (
            "period", "modulo", "scale", "unit", "origin", "anchor", "level", "block_start",
            "low_cycle", "low", "last", "lows", "moved",
        )
    ]
    + [("slope", "f8")]
)  # fmt: skip


class Rows(NamedTuple):
    """Frames of the messages of one clock in order, each (n,).

    ``lane``: its message; ``counter``: -1 without one; what is found: ``state``, ``t_ns``, ``lost``
    and ``moved``, ``SampleClock.moved_ns`` after it.
    """

    stamp: Ints
    lane: Ints
    counter: Ints
    state: Ints
    t_ns: Ints
    lost: Ints
    moved: Ints


class Ring(NamedTuple):
    """What each lane has seen last, (lanes, 16): counter, stamp, row of its payload.

    ``size``, ``recent`` (lanes,): places in use (0: nobody looks), and for how long they count.
    """

    counter: Ints
    stamp: Ints
    row: Ints
    size: Ints
    recent: Ints


@kernel
def _again(r: Ring, i: int, stamp: int, counter: int, row: int, data: Any, width: Any) -> int:
    """As ``Seen.again``: GOOD for a new counter."""
    size = r.size[i]
    if size == 0:
        return GOOD
    place = counter % size
    if r.counter[i, place] == counter and abs(stamp - r.stamp[i, place]) < r.recent[i]:
        r.stamp[i, place] = stamp
        before = r.row[i, place]
        for k in range(width[i]):
            if data[row, k] != data[before, k]:
                return SECOND_SENDER
        return REPEATED
    r.counter[i, place], r.stamp[i, place], r.row[i, place] = counter, stamp, row
    return GOOD


@kernel
def after_last(lane: Any, stamp: int) -> int:
    """As ``MessageDecoder._after``."""
    if lane.has_last != 0 and lane.last_ns - _STRAIGHT_NS < stamp <= lane.last_ns:
        stamp = lane.last_ns + _STAMP_NS
    lane.has_last, lane.last_ns = 1, stamp
    return stamp


@kernel
def due_of(line: Any, cycle: int) -> int:
    """When a ``cycle`` is due on the line (ns)."""
    ahead = line.level + line.slope * (cycle - line.anchor)
    return line.origin + cycle * line.period + int(np.rint(ahead))


@kernel
def _forward(line: Any, lane: Any, stamp: int, due: int) -> int:
    if lane.has_t != 0 and due <= lane.t and lane.t + MIN_STEP_NS <= stamp + line.period:
        due = lane.t + MIN_STEP_NS
    lane.has_t, lane.t = 1, due
    return due


@kernel
def _came_again(line: Any, lane: Any, stamp: int, counter: int, other_data: bool) -> None:
    """As ``SampleClock.again``."""
    since = stamp - lane.again_stamp
    still = counter == lane.again and other_data
    follows = still or counter == (lane.again + 1) % line.modulo
    if line.period // 4 < since < 2 * line.unit and lane.stamp <= lane.again_stamp and follows:
        lane.again_run += 1
    else:
        lane.again_run = 1
    lane.again, lane.again_stamp, lane.again_still = counter, stamp, 1 if still else 0


@kernel
def by_stamp(
    rows: Rows, lanes: Any, ring: Ring, modulo: Ints, data: Any, number: Ints, width: Ints
) -> None:
    """Messages without a clock: the stamps, and what their counters say (modulo 0: nothing)."""
    for k in range(len(rows.stamp)):
        i = rows.lane[k]
        lane = lanes[i]
        stamp, counter = rows.stamp[k], rows.counter[k]
        if rows.state[k] == BAD or modulo[i] == 0:
            rows.t_ns[k] = after_last(lane, stamp)
            continue
        again = _again(ring, i, stamp, counter, number[k], data, width)
        rows.state[k] = again
        if again == REPEATED:
            continue
        if again == SECOND_SENDER:
            rows.t_ns[k] = after_last(lane, stamp)
            continue
        advance = (counter - lane.counter) % modulo[i] if lane.joined != 0 else 1
        lane.joined, lane.counter = 1, counter
        if advance == 0:
            rows.state[k] = REPEATED
            continue
        rows.lost[k] = advance - 1
        rows.t_ns[k] = after_last(lane, stamp)


@kernel
def on_the_line(c: Any, lane: Any, i: int, lows: Ints, t: int, counter: int, cycles: int) -> int:
    """The instant of a frame of lane ``i`` that is in time, as ``SampleClock`` places it.

    ``cycles``: how many went by since the lane's last frame.
    """
    lane.repeated = lane.in_a_row = 0
    lane.late_total = lane.late_run = lane.late_last = lane.has_behind = 0
    lane.in_time += 1
    cycle = lane.cycle + cycles
    lane.counter, lane.cycle, lane.stamp, c.last = counter, cycle, t, i
    residual = t - c.origin - cycle * c.period
    if cycle - c.block_start >= BLOCK * c.scale:
        _block_ends(c, lows)
        c.block_start, c.low_cycle, c.low = cycle, cycle, residual
    elif residual - c.low < c.slope * (cycle - c.low_cycle):
        c.low_cycle, c.low = cycle, residual
    lower = residual - c.level - c.slope * (cycle - c.anchor)
    if lower < 0.0:
        c.anchor, c.level = cycle, residual
        c.moved += int(np.rint(lower))
    return _forward(c, lane, t, due_of(c, cycle))


@kernel
def by_counter(
    rows: Rows, lanes: Any, line: Any, lows: Ints, ring: Ring, data: Any, number: Ints,
    width: Ints, since: int,
) -> int:  # fmt: skip
    """Rows ``since`` onwards on the line of their clock, to the first that the clock is to judge.

    That row's number, or -1; it was looked up in ``ring`` already.
    """
    c = line[0]
    for k in range(since, len(rows.stamp)):
        i = rows.lane[k]
        lane = lanes[i]
        t, counter = rows.stamp[k], rows.counter[k]
        rows.moved[k] = c.moved
        again = GOOD
        if rows.state[k] != BAD:
            again = _again(ring, i, t, counter, number[k], data, width)
            rows.state[k] = again
            if again != GOOD:
                _came_again(c, lane, t, counter, again == SECOND_SENDER)
        if rows.state[k] == BAD or again == SECOND_SENDER:
            due = due_of(c, lane.cycle + 1) if lane.joined != 0 else t
            rows.t_ns[k] = _forward(c, lane, t, min(due, t))
            continue
        if again == REPEATED:
            continue
        if lane.joined == 0:
            return k
        skip = (counter - lane.counter) % c.modulo
        early = t + c.period // 2 - due_of(c, lane.cycle)
        elapsed = early // c.period
        if skip == 0 and (lane.repeated != 0 or elapsed < c.modulo):
            lane.repeated = 1
            rows.state[k] = REPEATED
            continue
        if skip > elapsed:
            return k
        cycles = skip + (elapsed - skip) // c.modulo * c.modulo
        late = early - c.period // 2 - cycles * c.period
        if late > LATE * c.unit:
            return k
        rows.t_ns[k] = on_the_line(c, lane, i, lows, t, counter, cycles)
        rows.moved[k] = c.moved
        rows.lost[k] = cycles - 1
    return _DONE


@kernel
def _block_ends(c: Any, lows: Ints) -> None:
    """As ``SampleClock._remember`` at the end of a block."""
    if c.lows == SLOPE_BLOCKS:
        for k in range(SLOPE_BLOCKS - 1):
            lows[k, 0], lows[k, 1] = lows[k + 1, 0], lows[k + 1, 1]
        c.lows -= 1
    lows[c.lows, 0], lows[c.lows, 1] = c.low_cycle, c.low
    c.lows += 1
    if c.lows >= SLOPE_MIN_BLOCKS:
        old = _lowest(c, lows, 0, c.lows // 2)
        new = _lowest(c, lows, c.lows // 2, c.lows)
        limit = MAX_DRIFT * c.period
        slope = (lows[new, 1] - lows[old, 1]) / (lows[new, 0] - lows[old, 0])
        c.slope += 0.5 * (max(-limit, min(limit, slope)) - c.slope)
    found = _lowest(c, lows, max(c.lows - ENVELOPE_BLOCKS, 0), c.lows)
    c.anchor, c.level = lows[found, 0], lows[found, 1]


@kernel
def _lowest(c: Any, lows: Ints, since: int, end: int) -> int:
    best = since
    for k in range(since + 1, end):
        if lows[k, 1] - c.slope * lows[k, 0] < lows[best, 1] - c.slope * lows[best, 0]:
            best = k
    return best
