"""All frames of a log to samples at once: the answers of :class:`FrameDecoder`, by columns.

Frames are grouped by message; bits, counters and CRC are taken as arrays. What a signal is (place,
width, byte order, sign, scale, range, values that are none) is asked of the database, as there.
Messages that this does not know (multiplexed ones, numbers that a float does not hold) make it
return None, and the log is then decoded frame by frame.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.bus import instants
from eps_hil.bus.bits import Bits, bits_of
from eps_hil.bus.clock_state import ClockState
from eps_hil.bus.frame_columns import FrameColumns
from eps_hil.bus.message_decoder import STAMP_RESOLUTION_NS, MessageDecoder
from eps_hil.bus.protection import CrcRule

Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]
_MOST_MODULO = 1 << 52


@dataclass(frozen=True, slots=True)
class DecodedColumns:
    """``samples``: stamps (n,) and values (n,) of each signal, in the order of first occurrence.

    ``faults``: kind -> message -> how often, messages in the order in which it befell them.
    """

    samples: dict[str, tuple[Ints, Floats]]
    faults: dict[str, dict[str, int]]


class _Message:
    """Frames of one message, and what is found of them; all (n,)."""

    def __init__(
        self, plan: MessageDecoder, bits: Mapping[str, Bits], frames: FrameColumns, rows: Ints
    ) -> None:
        self.plan, self.bits, self.rows = plan, bits, rows
        self.data = frames.data[rows, : plan.length]
        if self.data.shape[1] < plan.length:
            short = plan.length - self.data.shape[1]
            self.data = np.pad(self.data, ((0, 0), (0, short)))
        self.short = frames.length[rows] < plan.length
        self.wrong = np.zeros(len(rows), bool)
        if plan.crc is not None:
            self.wrong = (expected_crc(plan.crc, self.data) != self.data[:, plan.crc.byte]) & ~(
                self.short
            )
        self.stamp = (frames.t_ns[rows] + STAMP_RESOLUTION_NS // 2) // STAMP_RESOLUTION_NS
        self.stamp *= STAMP_RESOLUTION_NS
        self.counter = np.full(len(rows), -1, np.int64)
        if plan.counter is not None:
            self.counter = bits[plan.counter].raw(self.data).astype(np.int64)
        self.state = np.where(self.short | self.wrong, instants.BAD, instants.GOOD)
        self.t_ns = np.zeros(len(rows), np.int64)
        self.lost = np.zeros(len(rows), np.int64)
        self.restarted = np.zeros(0, np.int64)


def decode_columns(
    plans: Mapping[int, MessageDecoder], frames: FrameColumns
) -> DecodedColumns | None:
    """Samples of the messages in ``plans`` (by :func:`key_of`), each decoder fresh.

    None where a message is to be decoded frame by frame.
    """
    messages: list[_Message] = []
    for key, plan in plans.items():
        rows = np.flatnonzero(frames.key == key)
        if not len(rows):
            continue
        bits = {name: bits_of(plan.signal(name), plan.length) for name in plan.needed}
        known = {name: each for name, each in bits.items() if each is not None}
        modulo = 0 if plan.check is None else plan.check.modulo
        if plan.multiplexed or len(known) < len(bits) or modulo > _MOST_MODULO:
            return None
        messages.append(_Message(plan, known, frames, rows))
    _find_instants(messages)
    return DecodedColumns(*_collected(messages))


def expected_crc(rule: CrcRule, data: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """The CRC of payloads (n, width), (n,).

    A CRC of messages of one length is affine over their bits: that of zeros, and on top of it
    what each byte adds.
    """
    width = data.shape[1]
    nothing = rule.expected(bytes(width))
    crc = np.full(len(data), nothing, np.uint8)
    for at in range(width):
        if at != rule.byte:
            before, after = bytes(at), bytes(width - at - 1)
            adds = [rule.expected(before + bytes((b,)) + after) ^ nothing for b in range(256)]
            crc ^= np.array(adds, np.uint8)[data[:, at]]
    return crc


def _find_instants(messages: Sequence[_Message]) -> None:
    """States, instants and losses of all frames."""
    clocks: dict[int, list[_Message]] = {}
    for message in messages:
        clock = message.plan.clock
        clocks.setdefault(id(message) if clock is None else id(clock), []).append(message)
    for together in clocks.values():
        order = np.argsort(np.concatenate([each.rows for each in together]), kind="stable")
        many = [len(each.rows) for each in together]
        width = np.array([each.plan.length for each in together], np.int64)
        data = np.zeros((len(order), int(width.max())), np.uint8)
        since = 0
        for each in together:
            data[since : since + len(each.rows), : each.plan.length] = each.data
            since += len(each.rows)
        rows = instants.Rows(
            np.concatenate([each.stamp for each in together])[order],
            np.repeat(np.arange(len(together)), many)[order],
            np.concatenate([each.counter for each in together])[order],
            np.concatenate([each.state for each in together])[order].astype(np.int64),
            np.zeros(len(order), np.int64),
            np.zeros(len(order), np.int64),
        )
        restarted = ClockState([each.plan for each in together]).run(rows, data, order, width)
        for k, each in enumerate(together):
            mine = rows.lane == k
            each.state, each.t_ns, each.lost = rows.state[mine], rows.t_ns[mine], rows.lost[mine]
            each.restarted = np.flatnonzero(restarted[mine])


def _collected(
    messages: Sequence[_Message],
) -> tuple[dict[str, tuple[Ints, Floats]], dict[str, dict[str, int]]]:
    samples: list[tuple[int, int, str, tuple[Ints, Floats]]] = []
    faults: list[tuple[int, str, str, int]] = []

    def note(message: _Message, fault: str, where: npt.NDArray[np.bool_], many: int = 0) -> None:
        if where.any():
            first = int(message.rows[int(np.argmax(where))])
            faults.append((first, fault, message.plan.name, many or int(np.count_nonzero(where))))

    for message in messages:
        there = message.state != instants.REPEATED
        good = message.state == instants.GOOD
        note(message, "length", message.short)
        note(message, "crc", message.wrong)
        note(message, "counter", ~there)
        note(message, "lost_frames", message.lost > 0, int(message.lost.sum()))
        again = np.zeros(len(there), bool)
        again[message.restarted] = True
        note(message, "clock_restarts", again)
        if not there.any():
            continue
        first = int(message.rows[int(np.argmax(there))])
        missing, outside = np.zeros(len(there), np.int64), np.zeros(len(there), np.int64)
        for place, signal in enumerate(message.plan.signals):
            value = np.full(len(there), math.nan)
            raw = message.bits[signal.name].raw(message.data[good])
            value[good], none = signal.read_all(raw)
            missing[good] += none
            outside[good] += np.isnan(value[good]) & ~none
            column = (message.t_ns[there], value[there])
            samples.append((first, place, signal.canonical, column))
        note(message, "not_available", missing > 0, int(missing.sum()))
        note(message, "out_of_range", outside > 0, int(outside.sum()))
    found: dict[str, dict[str, int]] = {}
    for _, fault, name, count in sorted(faults, key=lambda one: one[0]):
        found.setdefault(fault, {})[name] = count
    samples.sort(key=lambda one: one[:2])
    return {name: column for _, _, name, column in samples}, found
