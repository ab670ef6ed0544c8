"""A frame that comes as almost all do, from its payload to samples in one compiled call; and back.

What :class:`~eps_hil.bus.message_decoder.MessageDecoder` and
:class:`~eps_hil.bus.codec.FrameEncoder` do step by step in Python. A frame in which anything is
unusual (CRC, length, counter, a stamp that is late or early, a value that is none) changes nothing
here and is left to them, so what is unusual is written in one place.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.bus.instants import after_last, due_of, on_the_line
from eps_hil.bus.sample_clock import LATE
from eps_hil.compiled import kernel

UNUSUAL = -(1 << 62)
"""Instead of a frame's instant: nothing was changed, and the frame is still to be decoded."""
NO_PAYLOAD = -1
"""Instead of a payload: a value that is none, or beyond its range."""
MOST_BYTES = 8
"""Of a payload that is encoded here; and bytes over which a signal lies at most."""
MOST_VALUES = 8
"""Signals of a message that is encoded here."""
MOST_LABELS = 4
"""Raw numbers of one signal that are no values."""
_STAMP_NS = 1_000

Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]

FIELD = np.dtype(
    [("columns", "i8", (MOST_BYTES,))]
    + [(name, "i8") for name in ("bytes", "shift", "mask", "sign", "place", "labels")]
    + [("labelled", "i8", (MOST_LABELS,))]
    + [(name, "f8") for name in ("scale", "shifted", "low", "high", "factor", "offset")]
)
"""A signal in a payload: where its bits lie, and what makes a value of them (``ReadSignal``)."""
WRITTEN = np.dtype(
    [(name, "i8") for name in ("shift", "mask")]
    + [(name, "f8") for name in ("scale", "offset", "low", "high")]
)
"""A signal of a message to be sent (``WriteSignal``)."""
MESSAGE = np.dtype(
    [(name, "i8") for name in ("lane", "length", "crc_byte", "has_counter", "has_clock", "modulo")]
)


class Samples(NamedTuple):
    """Where samples wait, each (n,): a signal's number, its instant (ns), its value; and how many
    do, (1,)."""

    signal: Ints
    t_ns: Ints
    value: Floats
    filled: Ints


class SeenPayloads(NamedTuple):
    """The last frames of each lane by their counters (``Seen``), (lanes, 16): counter and stamp,
    and the payloads, (lanes, 16, length). ``size``, ``recent``, (lanes,): places in use, 0 where
    nobody looks, and for how long (ns) they count."""

    counter: Ints
    stamp: Ints
    payload: Bytes
    size: Ints
    recent: Ints


@kernel
def _raw(field: Any, data: Any) -> int:
    number = 0
    for k in range(field.bytes):
        number |= int(data[field.columns[k]]) << (8 * k)
    return ((number >> field.shift & field.mask) ^ field.sign) - field.sign


@kernel
def _crc(table: Bytes, data: Any, length: int) -> int:
    """By what each byte adds to it, the last row what is left of none (:func:`crc_table`)."""
    found = int(table[length, 0])
    for k in range(length):
        found ^= int(table[k, data[k]])
    return found


@kernel
def take_frame(
    message: Any, fields: Any, table: Bytes, lanes: Any, line: Any, lows: Ints, seen: SeenPayloads,
    samples: Samples, data: bytes, t_ns: int,
) -> int:  # fmt: skip
    """The instant (ns) of a frame of ``message``, and its samples wait; or UNUSUAL.

    ``fields``: the counter first, then what is read. ``lanes``, ``line``, ``lows``, ``seen``: what
    is known of the messages of its clock.
    """
    m = message[0]
    length, i, at = m.length, m.lane, samples.filled[0]
    if at + len(fields) > len(samples.value):
        return UNUSUAL
    if len(data) < length or (m.crc_byte >= 0 and _crc(table, data, length) != data[m.crc_byte]):
        return UNUSUAL
    for k in range(1, len(fields)):
        field = fields[k]
        raw = _raw(field, data)
        for j in range(field.labels):
            if raw == field.labelled[j]:
                return UNUSUAL
        value = raw * field.scale + field.shifted
        if not field.low <= value <= field.high:
            return UNUSUAL
        samples.value[at + k - 1] = value * field.factor + field.offset
    stamp = (t_ns + _STAMP_NS // 2) // _STAMP_NS * _STAMP_NS
    instant = _instant(m, lanes[i], i, line[0], lows, seen, fields[0], data, stamp)
    if instant == UNUSUAL:
        return UNUSUAL
    for k in range(1, len(fields)):
        samples.signal[at + k - 1], samples.t_ns[at + k - 1] = fields[k].place, instant
    samples.filled[0] = at + len(fields) - 1
    return instant


@kernel
def _instant(
    m: Any, lane: Any, i: int, c: Any, lows: Ints, seen: SeenPayloads, counted: Any, data: Any,
    stamp: int,
) -> int:  # fmt: skip
    if m.has_counter == 0:
        return after_last(lane, stamp)
    counter = _raw(counted, data)
    if lane.joined == 0 or (counter - lane.counter) % m.modulo != 1:
        return UNUSUAL
    size = seen.size[i]
    place = counter % max(size, 1)
    there = seen.counter[i, place] == counter
    if size > 0 and there and abs(stamp - seen.stamp[i, place]) < seen.recent[i]:
        return UNUSUAL
    if m.has_clock != 0:
        early = stamp + c.period // 2 - due_of(c, lane.cycle)
        elapsed = early // c.period
        late = early - c.period // 2 - c.period
        if not 1 <= elapsed <= m.modulo or late > LATE * c.unit:
            return UNUSUAL
    if size > 0:
        seen.counter[i, place], seen.stamp[i, place] = counter, stamp
        for k in range(m.length):
            seen.payload[i, place, k] = data[k]
    if m.has_clock != 0:
        return on_the_line(c, lane, i, lows, stamp, counter, 1)
    lane.counter = counter
    return after_last(lane, stamp)


@kernel
def payload_of(
    message: Any, fields: Any, table: Bytes, number: int,
    v0: float, v1: float, v2: float, v3: float, v4: float, v5: float, v6: float, v7: float,
) -> int:  # fmt: skip
    """Values and what stands in ``number`` (the counter) as one number, least byte first, with the
    CRC; NO_PAYLOAD. ``message``: its length and the byte of its CRC."""
    m = message[0]
    for k in range(len(fields)):
        field = fields[k]
        value = v0
        if k == 1:
            value = v1
        elif k == 2:
            value = v2
        elif k == 3:
            value = v3
        elif k == 4:
            value = v4
        elif k == 5:
            value = v5
        elif k == 6:
            value = v6
        elif k == 7:
            value = v7
        raw = (value - field.offset) / field.scale
        if not field.low <= raw <= field.high:
            return NO_PAYLOAD
        number |= (int(np.rint(raw)) & field.mask) << field.shift
    if m.crc_byte < 0:
        return number
    crc = int(table[m.length, 0])
    for k in range(m.length):
        crc ^= int(table[k, number >> 8 * k & 0xFF])
    return number & ~(0xFF << 8 * m.crc_byte) | crc << 8 * m.crc_byte
