"""Frames of a live bus by compiled calls, as long as they come as almost all do.

Beside a decoder: what it knows of the messages of one clock is taken into arrays, where
:func:`~eps_hil.bus.live_kernels.take_frame` goes on with it. A frame that is unusual gives it back
to the decoder, which then decodes some frames more by itself: the same samples and faults.
"""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from eps_hil.bus.bit_packing import Packing
from eps_hil.bus.bits import bits_of
from eps_hil.bus.clock_state import MOST_SEEN, ClockState
from eps_hil.bus.frame import Frame
from eps_hil.bus.live_kernels import (
    FIELD,
    MESSAGE,
    MOST_BYTES,
    MOST_LABELS,
    MOST_VALUES,
    NO_PAYLOAD,
    UNUSUAL,
    WRITTEN,
    Samples,
    SeenPayloads,
    payload_of,
    take_frame,
)
from eps_hil.bus.message_decoder import MessageDecoder
from eps_hil.bus.protection import CrcRule
from eps_hil.bus.signal_codec import ReadSignal, WriteSignal
from eps_hil.compiled import direct

_REST, _LONGEST_REST = 64, 4_096
"""Frames of a clock that the decoder takes by itself from an unusual one on; twice as many each
time that the first one after them is unusual, too."""
_MOST_BITS = 52

Key = tuple[int, bool]


class LiveFrames:
    """Samples of frames of the messages ``plans``, where they lie in arrays of fixed size.

    ``places``: the number of each signal in ``samples``; a message with another one is left to the
    decoder. ``sync``: the message of which :attr:`moved_ns` is told.
    """

    def __init__(
        self,
        plans: Mapping[Key, MessageDecoder],
        places: Mapping[str, int],
        samples: Samples,
        sync: Key | None,
    ) -> None:
        self.names: tuple[str, ...] = ()
        """Signals of the frame that was taken last, in the order of their samples."""
        self._samples = samples
        self._messages: dict[Key, _Message] = {}
        together: dict[int, list[Key]] = {}
        for key, plan in plans.items():
            together.setdefault(id(plan.clock or plan), []).append(key)
        for keys in together.values():
            fields = [_fields(plans[key], places) for key in keys]
            if any(found is None for found in fields):
                continue
            clock = _Clock([plans[key] for key in keys])
            for lane, (key, found) in enumerate(zip(keys, fields, strict=True)):
                self._messages[key] = _Message(plans[key], clock, lane, found, samples)
        self._sync = None if sync is None else self._messages.get(sync)

    def take(self, key: Key, frame: Frame) -> int | None:
        """The instant (ns) of a frame whose samples wait now; ``key``: its id and format.

        None: they do not, and the frame is for the decoder.
        """
        message = self._messages.get(key)
        if message is None or frame.remote:
            return None
        clock = message.clock
        if not clock.here and not clock.ready():
            return None
        instant: int = message.take(frame.data, frame.t_ns)
        if instant == UNUSUAL:
            clock.give_back()
            return None
        clock.fresh = False
        self.names = message.names
        return instant

    def newest(self, signal: str) -> float:
        """The value of a ``signal`` among :attr:`names`, of the frame that was taken last."""
        behind = len(self.names) - self.names.index(signal)
        return float(self._samples.value[self._samples.filled[0] - behind])

    def give_back(self, key: Key) -> None:
        """Let the decoder go on by itself with a message, and all others of its clock."""
        message = self._messages.get(key)
        if message is not None:
            message.clock.give_back()

    def give_all_back(self) -> None:
        """Let the decoder go on by itself with all messages."""
        for message in self._messages.values():
            message.clock.give_back()

    @property
    def moved_ns(self) -> int | None:
        """As ``SampleClock.moved_ns`` of the sync message; None: the clock itself knows."""
        return None if self._sync is None else self._sync.clock.moved_ns


class _Message:
    """One message; ``take`` is the machine code with all but the frame."""

    def __init__(
        self, plan: MessageDecoder, clock: "_Clock", lane: int, fields: Any, samples: Samples
    ) -> None:
        self.clock = clock
        self.names = tuple(signal.canonical for signal in plan.signals)
        told = np.zeros(1, MESSAGE)
        told["lane"], told["length"] = lane, plan.length
        told["crc_byte"] = -1 if plan.crc is None else plan.crc.byte
        told["has_counter"], told["has_clock"] = plan.check is not None, plan.clock is not None
        told["modulo"] = 1 if plan.check is None else plan.check.modulo
        table = np.zeros((plan.length + 1, 256), np.uint8)
        if plan.crc is not None:
            table[:] = plan.crc.table(plan.length)
        arguments = (told, fields, table, *clock.arrays, samples)
        self.take = partial(direct(take_frame, *arguments, b"", 0), *arguments)


class _Clock(ClockState):
    """Messages of one clock, or one message without any, of decoders that have seen frames."""

    def __init__(self, plans: Sequence[MessageDecoder]) -> None:
        super().__init__(plans)
        self.here = self.fresh = False
        """Whether the arrays hold what is known, and nothing was taken since then."""
        self._rest, self._resting = 0, _REST
        shape = len(plans), MOST_SEEN, self.widest
        ring = self._ring
        self._seen = SeenPayloads(
            ring.counter, ring.stamp, np.zeros(shape, np.uint8), ring.size, ring.recent
        )

    @property
    def arrays(self) -> tuple[Any, ...]:
        """What the machine code goes on with."""
        return self._lanes, self._line, self._lows, self._seen

    @property
    def moved_ns(self) -> int | None:
        """As ``SampleClock.moved_ns``, where that is behind."""
        return int(self._line["moved"][0]) if self.here else None

    def ready(self) -> bool:
        """Take what the decoder knows, now and then; whether the arrays hold it now."""
        if self._rest > 0:
            self._rest -= 1
            return False
        self._rest = self._resting
        if self._clock is not None:
            if not all(self._clock.has(plan.name) for plan in self._plans):
                return False
            self.load()
        for lane, plan in enumerate(self._plans):
            self._remember(lane, plan)
        self.here = self.fresh = True
        return True

    def give_back(self) -> None:
        """Let the decoders know what the arrays hold."""
        if not self.here:
            return
        if self._clock is not None:
            self.store()
        for lane, plan in enumerate(self._plans):
            self._recall(lane, plan)
        self._resting = min(2 * self._resting, _LONGEST_REST) if self.fresh else _REST
        self.here, self._rest = False, self._resting

    def _remember(self, lane: int, plan: MessageDecoder) -> None:
        seen, at = self._seen, self._lanes[lane]
        if plan.seen is not None:
            counters, stamps, payloads = zip(*plan.seen.ring, strict=True)
            size, length = plan.seen.size, plan.length
            whole = b"".join(payload.ljust(length, b"\0") for payload in payloads)
            seen.counter[lane, :size], seen.stamp[lane, :size] = counters, stamps
            seen.payload[lane, :size, :length] = np.frombuffer(whole, np.uint8).reshape(size, -1)
        if self._clock is None:
            last, stamped = None if plan.check is None else plan.check.last, plan.last_ns
            at["joined"], at["counter"] = last is not None, 0 if last is None else last
            at["has_last"], at["last_ns"] = stamped is not None, stamped or 0

    def _recall(self, lane: int, plan: MessageDecoder) -> None:
        seen, at = self._seen, self._lanes[lane]
        if plan.seen is not None:
            size, length = plan.seen.size, plan.length
            whole = seen.payload[lane, :size, :length].tobytes()
            payloads = (whole[k : k + length] for k in range(0, size * length, length))
            counters, stamps = seen.counter[lane, :size].tolist(), seen.stamp[lane, :size].tolist()
            plan.seen.ring[:] = zip(counters, stamps, payloads, strict=True)
        if self._clock is None:
            if plan.check is not None and at["joined"]:
                plan.check.last = int(at["counter"])
            plan.last_ns = int(at["last_ns"]) if at["has_last"] else None


def _fields(plan: MessageDecoder, places: Mapping[str, int]) -> Any:
    """The counter and the signals of a message as the machine code reads them; None: it cannot."""
    if not plan.packed or any(signal.canonical not in places for signal in plan.signals):
        return None
    fields = np.zeros(1 + len(plan.signals), FIELD)
    names = [plan.counter, *(signal.name for signal in plan.signals)]
    for k, name in enumerate(names):
        if name is not None and not _put_bits(fields[k], plan, name):
            return None
    for k, signal in enumerate(plan.signals, start=1):
        if not _put_value(fields[k], signal):
            return None
        fields[k]["place"] = places[signal.canonical]
    return fields


def _put_bits(field: Any, plan: MessageDecoder, name: str) -> bool:
    bits = bits_of(plan.signal(name), plan.length)
    if bits is None or bits.real or bits.width > _MOST_BITS:
        return False
    field["columns"][: len(bits.columns)] = bits.columns
    field["bytes"], field["shift"] = len(bits.columns), bits.shift
    field["mask"] = (1 << bits.width) - 1
    field["sign"] = 1 << bits.width - 1 if bits.signed else 0
    return True


def _put_value(field: Any, signal: ReadSignal) -> bool:
    law, mask, sign = signal.law, int(field["mask"]), int(field["sign"])
    labelled = sorted(raw for raw in law.labelled if -sign <= raw <= mask - sign)
    if len(labelled) > MOST_LABELS or not signal.exact(-sign, mask - sign):
        return False
    field["labels"] = len(labelled)
    field["labelled"][: len(labelled)] = labelled
    for name in ("scale", "shifted", "low", "high", "factor", "offset"):
        field[name] = getattr(law, name)
    return not math.isnan(law.factor)


class CompiledPayload:
    """Payloads of one message of plain integers: ``call`` is the machine code with all but values.

    ``names``: its signals, in the order of the values.
    """

    def __init__(self, names: Sequence[str], packing: Packing, call: Any) -> None:
        self._names, self._call = names, call
        self._others = (0.0,) * (MOST_VALUES - len(names))
        self._nan = (math.nan,) * len(names)
        self._mask, self._length = (1 << 8 * packing.length) - 1, packing.length
        self._order = packing.order

    def payload(self, values: Mapping[str, float], counter: int) -> bytes | None:
        """The payload with ``counter`` at its place, and its CRC; None where a value is none, or
        beyond its range."""
        counter = (counter ^ 1 << 63) - (1 << 63)  # machine code has 64 bits with a sign
        number = self._call(counter, *map(values.get, self._names, self._nan), *self._others)
        if number == NO_PAYLOAD:
            return None
        return (number & self._mask).to_bytes(self._length, self._order)


def compiled_payload(
    packing: Packing, signals: Sequence[WriteSignal], crc: CrcRule | None
) -> CompiledPayload | None:
    """What encodes a message by machine code; None where that cannot.

    ``signals``: without counter and CRC.
    """
    length = packing.length
    if len(signals) > MOST_VALUES or length > MOST_BYTES or any(one.real for one in signals):
        return None
    fields = np.zeros(len(signals), WRITTEN)
    for field, signal in zip(fields, signals, strict=True):
        shift, mask, _ = packing.places[signal.name]
        if mask >= 1 << _MOST_BITS:
            return None
        field["shift"], field["mask"] = shift, mask
        field["scale"], field["offset"], field["low"], field["high"] = signal.law
    told, table = np.zeros(1, MESSAGE), np.zeros((length + 1, 256), np.uint8)
    told["length"], told["crc_byte"] = length, -1
    if crc is not None:
        rows = crc.table(length)
        little = packing.order == "little"
        table[:] = rows if little else [*rows[length - 1 :: -1], rows[length]]
        told["crc_byte"] = crc.byte if little else length - 1 - crc.byte
    arguments = (told, fields, table)
    call = direct(payload_of, *arguments, 0, *(0.0,) * MOST_VALUES)
    return CompiledPayload([one.name for one in signals], packing, partial(call, *arguments))
