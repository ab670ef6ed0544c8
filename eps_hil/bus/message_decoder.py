"""One mapped message on its way in: checks, sample instant, values."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from eps_hil.bus.bit_packing import packing_of
from eps_hil.bus.frame import Frame
from eps_hil.bus.protection import CounterCheck, CrcRule, Seen
from eps_hil.bus.sample_clock import Instant, SampleClock
from eps_hil.bus.signal_codec import ReadSignal

STAMP_RESOLUTION_NS = 1_000


class Sample(NamedTuple):
    """``value`` of a canonical ``signal`` at ``t_ns``; NaN: there was one, but it is no good."""

    signal: str
    t_ns: int
    value: float


_sample = partial(tuple.__new__, Sample)
"""``Sample._make`` in half the time: three to five of them stand before every answer."""


class MessageDecoder:
    """Decodes frames of one message; ``crc``, ``counter``, ``seen`` and ``clock`` are the owner's.

    A message of plain integers is read by shifts (bit_packing.py), any other by cantools.
    """

    def __init__(self, message: Any, signals: Sequence[ReadSignal], faults: dict[str, int]) -> None:
        self.name: str = message.name
        self.crc: CrcRule | None = None
        self.counter: str | None = None
        self.check: CounterCheck | None = None
        self.clock: SampleClock | None = None
        self.seen: Seen | None = None
        self._message = message
        self._length: int = message.length
        self._signals = tuple(signals)
        self._names = tuple(signal.canonical for signal in signals)
        self._packing = packing_of(message)
        self._fields = self._mapped_fields()
        self._faults = faults
        self.last_ns: int | None = None
        """The last instant that is a stamp."""

    @property
    def length(self) -> int:
        """Bytes of the message, as the database has it."""
        return self._length

    @property
    def signals(self) -> tuple[ReadSignal, ...]:
        """What is read of it, in the order of the mapping."""
        return self._signals

    @property
    def packed(self) -> bool:
        """Whether it is read by shifts."""
        return self._packing is not None

    @property
    def needed(self) -> tuple[str, ...]:
        """Names of the signals that are read, with the counter."""
        names = tuple(signal.name for signal in self._signals)
        return names if self.counter is None else (*names, self.counter)

    @property
    def multiplexed(self) -> bool:
        """Whether it depends on the frame which signals there are."""
        return bool(self._message.is_multiplexed())

    def signal(self, name: str) -> Any:
        """The database's signal of that name."""
        return self._message.get_signal_by_name(name)

    def decode(self, frame: Frame) -> list[Sample]:
        """Samples of a frame of this message; NaN in all of them if it cannot be trusted."""
        stamp = (frame.t_ns + STAMP_RESOLUTION_NS // 2) // STAMP_RESOLUTION_NS * STAMP_RESOLUTION_NS
        data, length = frame.data, self._length
        if len(data) > length:
            data = data[:length]  # CAN FD pads to the next length it has
        if len(data) < length:
            return self._bad(stamp, "length")
        if self.crc is not None and not self.crc.good(data):
            return self._bad(stamp, "crc")
        packing = self._packing
        if packing is None:
            return self._by_cantools(stamp, data)
        number = int.from_bytes(data, packing.order)
        place = packing.places.get(self.counter)
        if place is None:
            return self._unpacked(self._after(stamp), number)
        shift, mask, sign = place
        at = self._instant(stamp, (number >> shift & mask ^ sign) - sign, data)
        if at is None:
            return []
        return self._unpacked(at.t_ns, number) if at.trusted else self._nothing(at.t_ns)

    def _by_cantools(self, stamp: int, data: bytes) -> list[Sample]:
        try:
            raw = self._message.decode(data, decode_choices=False, scaling=False)
        except Exception:  # cantools raises what it likes on a multiplexer that is not defined
            return self._bad(stamp, "not_decodable")
        counter = raw.get(self.counter)
        if counter is None:
            return self._samples(self._after(stamp), raw)
        at = self._instant(stamp, counter, data)
        if at is None:
            return []
        return self._samples(at.t_ns, raw) if at.trusted else self._nothing(at.t_ns)

    def _mapped_fields(self) -> tuple[tuple[ReadSignal, str, int, int, int], ...]:
        """What is read of a packed message: (signal, canonical name, shift, mask, sign)."""
        if self._packing is None:
            return ()
        places = self._packing.places
        return tuple((s, s.canonical, *places[s.name]) for s in self._signals)

    def _unpacked(self, t_ns: int, number: int) -> list[Sample]:
        samples = []
        for signal, name, shift, mask, sign in self._fields:
            raw = (number >> shift & mask ^ sign) - sign
            value = signal.read(raw)
            if math.isnan(value):
                self._faults[signal.why_not(raw)] += 1
            samples.append(_sample((name, t_ns, value)))
        return samples

    def _nothing(self, t_ns: int) -> list[Sample]:
        return [Sample(name, t_ns, math.nan) for name in self._names]

    def _samples(self, t_ns: int, raw: Mapping[Any, Any]) -> list[Sample]:
        samples = []
        for signal in self._signals:
            value = raw.get(signal.name)
            if value is None:
                continue  # multiplexed, and not in this frame
            read = signal.read(value)
            if math.isnan(read):
                self._faults[signal.why_not(value)] += 1
            samples.append(Sample(signal.canonical, t_ns, read))
        return samples

    def _instant(self, stamp: int, counter: int, data: bytes) -> Instant | None:
        """Sample instant of a frame with a right CRC; None if it repeats one before."""
        faults = self._faults
        again = None if self.seen is None else self.seen.again(stamp, counter, data)
        if again is not None and self.clock is not None:
            self.clock.again(stamp, counter, self.name, other_data=not again)
        if again is False:
            faults["second_sender"] += 1
            return Instant(self._expected(stamp), trusted=False)
        if again:
            at = None
        elif self.clock is not None:
            at = self.clock.instant(stamp, counter, self.name)
        else:
            advance = self.check.advance(counter) if self.check is not None else 1
            at = Instant(self._after(stamp), advance - 1) if advance else None
        if at is None:
            faults["counter"] += 1
            return None
        if at.lost:
            faults["lost_frames"] += at.lost
        if at.restarted:
            faults["clock_restarts"] += 1
        if not at.trusted:
            faults["not_trusted"] += 1
        return at

    def _bad(self, stamp: int, fault: str) -> list[Sample]:
        self._faults[fault] += 1
        return self._nothing(self._expected(stamp))

    def _expected(self, stamp: int) -> int:
        return self._after(stamp) if self.clock is None else self.clock.expected(stamp, self.name)

    def _after(self, stamp: int) -> int:
        """The stamp, kept strictly increasing where two frames share one microsecond."""
        last = self.last_ns
        if last is not None and last - 1_000_000 < stamp <= last:
            stamp = last + STAMP_RESOLUTION_NS
        self.last_ns = stamp
        return stamp
