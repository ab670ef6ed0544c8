"""Many frames of a log to samples at once: the answers of :class:`FrameDecoder`, by columns.

Frames are grouped by message; bits, counters and CRC are taken as arrays. What a signal is (place,
width, byte order, sign, scale, range, values that are none) is asked of the database, as there.
Messages that this does not know (multiplexed ones, numbers that a float does not hold) are
refused, and the log is then decoded frame by frame. A long log comes in pieces: what one piece
leaves behind (clocks, counters, the last payloads) the next one begins with.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.bus import instants
from eps_hil.bus.bits import Bits, bits_of
from eps_hil.bus.clock_state import ClockState
from eps_hil.bus.frame_columns import FrameColumns
from eps_hil.bus.message_decoder import STAMP_RESOLUTION_NS, MessageDecoder
from eps_hil.growing import Growing
from eps_hil.series import Arrivals

Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]
_MOST_MODULO = 1 << 52


@dataclass(frozen=True, slots=True)
class DecodedColumns:
    """``samples``: stamps (n,) and values (n,) of each signal, in the order of first occurrence.

    ``faults``: kind -> message -> how often, messages in the order in which it befell them.
    ``arrivals``: of the sync message, where one is mapped.
    """

    samples: dict[str, tuple[Ints, Floats]]
    faults: dict[str, dict[str, int]]
    arrivals: Arrivals | None = None


@dataclass(slots=True)
class _Column:
    """A signal so far: what it came with first (frame, place in its message), and its samples.

    ``t_ns`` is the same one for all signals of a message.
    """

    first: tuple[int, int]
    t_ns: Growing
    value: Growing


class _Layout(NamedTuple):
    """Where what is needed of a message stands; ``crc``: ``CrcRule.table`` of its length."""

    bits: Mapping[str, Bits]
    crc: Bytes | None


class _Message:
    """Frames of one message, and what is found of them; all (n,)."""

    def __init__(
        self, plan: MessageDecoder, layout: _Layout, frames: FrameColumns, rows: Ints
    ) -> None:
        bits = layout.bits
        self.plan, self.bits, self.rows = plan, bits, rows
        self.data = np.take(frames.data, rows, axis=0)[:, : plan.length]
        if self.data.shape[1] < plan.length:
            short = plan.length - self.data.shape[1]
            self.data = np.pad(self.data, ((0, 0), (0, short)))
        self.short = frames.length[rows] < plan.length
        self.wrong = np.zeros(len(rows), bool)
        if plan.crc is not None and layout.crc is not None:
            self.wrong = expected_crc(layout.crc, self.data) != self.data[:, plan.crc.byte]
            self.wrong &= ~self.short
        self.stamp = (frames.t_ns[rows] + STAMP_RESOLUTION_NS // 2) // STAMP_RESOLUTION_NS
        self.stamp *= STAMP_RESOLUTION_NS
        self.counter = np.full(len(rows), -1, np.int64)
        if plan.counter is not None:
            self.counter = bits[plan.counter].raw(self.data).astype(np.int64)
        self.state = np.where(self.short | self.wrong, instants.BAD, instants.GOOD)
        self.t_ns = np.zeros(len(rows), np.int64)
        self.lost = np.zeros(len(rows), np.int64)
        self.moved = np.zeros(len(rows), np.int64)
        self.restarted = np.zeros(0, np.int64)


class ColumnDecoder:
    """Decodes the messages in ``plans`` (by :func:`key_of`), whose decoders are fresh.

    ``sync``: the one that the estimator steps on.
    """

    def __init__(self, plans: Mapping[int, MessageDecoder], sync: int | None = None) -> None:
        self._plans, self._sync = plans, sync
        self._arrivals = [Growing(np.int64) for _ in Arrivals._fields]
        self._layouts: dict[int, _Layout] = {}
        self._before = 0
        self._columns: dict[str, _Column] = {}
        self._stamps: dict[int, Growing] = {}
        self._faults: dict[tuple[str, str], tuple[int, int]] = {}
        clocks: dict[int, list[int]] = {}
        for key, plan in plans.items():
            clock = id(plan) if plan.clock is None else id(plan.clock)
            clocks.setdefault(clock, []).append(key)
        self._clocks = [
            (keys, ClockState([plans[key] for key in keys])) for keys in clocks.values()
        ]

    def add(self, frames: FrameColumns) -> bool:
        """Decode what follows; False where a message is to be decoded frame by frame."""
        messages: dict[int, _Message] = {}
        for key, plan in self._plans.items():
            rows = np.flatnonzero(frames.key == key)
            if not len(rows):
                continue
            layout = self._layouts.get(key) or _layout(plan)
            if layout is None:
                return False
            self._layouts[key] = layout
            messages[key] = _Message(plan, layout, frames, rows)
        for keys, state in self._clocks:
            mine = [(lane, messages[key]) for lane, key in enumerate(keys) if key in messages]
            if mine:
                _find_instants(mine, state)
        for key, message in messages.items():
            self._collect(key, message)
        if (sync := messages.get(-1 if self._sync is None else self._sync)) is not None:
            there = sync.state != instants.REPEATED
            found = (frames.t_ns[sync.rows], sync.t_ns, sync.moved)
            for growing, more in zip(self._arrivals, found, strict=True):
                growing.add(more[there])
        self._before += len(frames.key)
        return True

    def result(self) -> DecodedColumns:
        """What was found; signals of one message share their stamps. Nothing is added then."""
        faults: dict[str, dict[str, int]] = {}
        for (fault, name), (_, count) in sorted(self._faults.items(), key=lambda one: one[1][0]):
            faults.setdefault(fault, {})[name] = count
        samples = {
            name: (column.t_ns.whole(), column.value.whole())
            for name, column in sorted(self._columns.items(), key=lambda one: one[1].first)
        }
        arrivals = Arrivals(*(each.whole() for each in self._arrivals))
        return DecodedColumns(samples, faults, None if self._sync is None else arrivals)

    def _collect(self, key: int, message: _Message) -> None:
        there = message.state != instants.REPEATED
        good = message.state == instants.GOOD
        self._note(message, "length", message.short)
        self._note(message, "crc", message.wrong)
        self._note(message, "counter", ~there)
        self._note(message, "lost_frames", message.lost > 0, int(message.lost.sum()))
        again = np.zeros(len(there), bool)
        again[message.restarted] = True
        self._note(message, "clock_restarts", again)
        if not there.any():
            return
        first = self._before + int(message.rows[int(np.argmax(there))])
        read, kept = _those(good), _those(there)
        stamps = self._stamps.setdefault(key, Growing(np.int64))
        stamps.add(message.t_ns[kept])
        missing, outside = np.zeros(len(there), np.int64), np.zeros(len(there), np.int64)
        for place, signal in enumerate(message.plan.signals):
            value = np.full(len(there), math.nan)
            raw = message.bits[signal.name].raw(message.data[read])
            value[read], none = signal.read_all(raw)
            missing[read] += none
            outside[read] += np.isnan(value[read]) & ~none
            column = self._columns.setdefault(
                signal.canonical, _Column((first, place), stamps, Growing(np.float64))
            )
            column.value.add(value[kept])
        self._note(message, "not_available", missing > 0, int(missing.sum()))
        self._note(message, "out_of_range", outside > 0, int(outside.sum()))

    def _note(
        self, message: _Message, fault: str, where: npt.NDArray[np.bool_], many: int = 0
    ) -> None:
        if where.any():
            first = self._before + int(message.rows[int(np.argmax(where))])
            first, count = self._faults.get((fault, message.plan.name), (first, 0))
            count += many or int(np.count_nonzero(where))
            self._faults[fault, message.plan.name] = first, count


def _those(where: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_] | slice:
    """What takes them out of an array: all of them without a copy."""
    return slice(None) if where.all() else where


def _layout(plan: MessageDecoder) -> _Layout | None:
    """None where a message is decoded frame by frame."""
    bits = {name: bits_of(plan.signal(name), plan.length) for name in plan.needed}
    known = {name: each for name, each in bits.items() if each is not None}
    modulo = 0 if plan.check is None else plan.check.modulo
    if plan.multiplexed or len(known) < len(bits) or modulo > _MOST_MODULO:
        return None
    crc = None if plan.crc is None else np.array(plan.crc.table(plan.length), np.uint8)
    return _Layout(known, crc)


def expected_crc(table: Bytes, data: Bytes) -> Bytes:
    """The CRC of payloads (n, width), (n,), by the ``table`` of that width."""
    crc = np.full(len(data), table[-1, 0])
    for row, column in zip(table[:-1], data.T, strict=True):
        if row.any():  # not the CRC's own byte
            crc ^= row[column]
    return crc


def _find_instants(mine: Sequence[tuple[int, _Message]], clock: ClockState) -> None:
    """States, instants and losses of the frames of one clock; each message with its lane."""
    together = [message for _, message in mine]
    order = np.argsort(np.concatenate([each.rows for each in together]), kind="stable")
    many = [len(each.rows) for each in together]
    data = np.zeros((len(order), clock.widest), np.uint8)
    since = 0
    for each in together:
        data[since : since + len(each.rows), : each.plan.length] = each.data
        since += len(each.rows)
    rows = instants.Rows(
        np.concatenate([each.stamp for each in together])[order],
        np.repeat([lane for lane, _ in mine], many)[order],
        np.concatenate([each.counter for each in together])[order],
        np.concatenate([each.state for each in together])[order].astype(np.int64),
        np.zeros(len(order), np.int64),
        np.zeros(len(order), np.int64),
        np.zeros(len(order), np.int64),
    )
    restarted = clock.run(rows, data, order)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    for (_, each), its in zip(mine, np.split(place, np.cumsum(many)[:-1]), strict=True):
        each.state, each.t_ns = rows.state[its], rows.t_ns[its]
        each.lost, each.moved = rows.lost[its], rows.moved[its]
        each.restarted = np.flatnonzero(restarted[its])
