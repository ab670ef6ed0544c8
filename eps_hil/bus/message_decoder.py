"""One mapped message on its way in: checks, sample instant, values."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from eps_hil.bus.frame import Frame
from eps_hil.bus.protection import CounterCheck, CrcRule
from eps_hil.bus.sample_clock import Instant, SampleClock
from eps_hil.bus.signal_codec import ReadSignal

STAMP_RESOLUTION_NS = 1_000


class Sample(NamedTuple):
    """``value`` of a canonical ``signal`` at ``t_ns``; NaN: there was one, but it is no good."""

    signal: str
    t_ns: int
    value: float


class MessageDecoder:
    """Decodes frames of one message; ``crc``, ``counter`` and ``clock`` are set by the owner."""

    def __init__(self, message: Any, signals: Sequence[ReadSignal], faults: dict[str, int]) -> None:
        self.name: str = message.name
        self.crc: CrcRule | None = None
        self.counter: str | None = None
        self.check: CounterCheck | None = None
        self.clock: SampleClock | None = None
        self._message = message
        self._length: int = message.length
        self._signals = tuple(signals)
        self._faults = faults
        self._last_ns: int | None = None

    def decode(self, frame: Frame) -> list[Sample]:
        """Samples of a frame of this message; NaN in all of them if it cannot be trusted."""
        stamp = (frame.t_ns + STAMP_RESOLUTION_NS // 2) // STAMP_RESOLUTION_NS * STAMP_RESOLUTION_NS
        data = frame.data
        if len(data) < self._length:
            return self._bad(stamp, "length")
        if len(data) > self._length:
            data = data[: self._length]  # CAN FD pads to the next length it has
        if self.crc is not None and not self.crc.good(data):
            return self._bad(stamp, "crc")
        try:
            raw = self._message.decode(data, decode_choices=False, scaling=False)
        except Exception:  # cantools raises what it likes on a multiplexer that is not defined
            return self._bad(stamp, "not_decodable")
        t_ns = self._instant(stamp, raw)
        if t_ns is None:
            return []
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

    def _instant(self, stamp: int, raw: Mapping[str, Any]) -> int | None:
        """Sample instant of a good frame; None if it repeats the one before."""
        if self.check is None or self.counter is None or self.counter not in raw:
            return self._after(stamp)
        counter = int(raw[self.counter])
        faults = self._faults
        if self.clock is None:
            advance = self.check.advance(counter)
            at = Instant(self._after(stamp), advance - 1) if advance else None
        else:
            at = self.clock.instant(stamp, counter, self.name)
        if at is None:
            faults["counter"] += 1
            return None
        faults["lost_frames"] += at.lost
        faults["clock_restarts"] += at.restarted
        return at.t_ns

    def _bad(self, stamp: int, fault: str) -> list[Sample]:
        self._faults[fault] += 1
        clock = self.clock
        t_ns = self._after(stamp) if clock is None else clock.expected(stamp, self.name)
        return [Sample(signal.canonical, t_ns, math.nan) for signal in self._signals]

    def _after(self, stamp: int) -> int:
        """The stamp, kept strictly increasing where two frames share one microsecond."""
        last = self._last_ns
        if last is not None and last - 1_000_000 < stamp <= last:
            stamp = last + STAMP_RESOLUTION_NS
        self._last_ns = stamp
        return stamp
