"""Counter and CRC of a message: which frames to trust, and how many are missing.

The default profile computes the CRC of AUTOSAR E2E profile 1 in its both-bytes data-id mode
(CRC-8 SAE J1850, start value 0, no final XOR; PRS E2E Protocol, 6.3), whose vector 0xCC the tests
hold. Counter and CRC may sit anywhere in the frame and the counter may have any width, because
the databases of cars do as they like; that is why this is a few lines over fastcrc rather than
an E2E library, which fixes the header's layout.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fastcrc import crc8

E2E_P01 = "e2e_p01"
PROFILES = (E2E_P01, *sorted(crc8.algorithms_available))
"""``e2e_p01``, or the name of any plain CRC-8 of fastcrc (``sae_j1850``, ``autosar``, ...)."""

_INVERT = 0xFF  # J1850 starts from and ends with 0xFF, profile 1 does neither: undone here


@dataclass(frozen=True, slots=True)
class CrcRule:
    """Where a message keeps its CRC byte and how the byte is computed.

    ``data_id`` (16 bits, low byte first) goes into the CRC before the payload; None: it does not.
    """

    byte: int
    compute: Callable[[bytes], int]

    @classmethod
    def make(cls, byte: int, profile: str = E2E_P01, data_id: int | None = None) -> "CrcRule":
        """Rule of a ``profile`` of :data:`PROFILES`; profile 1 needs a ``data_id``."""
        prefix = b"" if data_id is None else bytes((data_id & 0xFF, data_id >> 8 & 0xFF))
        if profile == E2E_P01:
            compute: Callable[[bytes, int], int] = crc8.sae_j1850
            start = compute(prefix, _INVERT)

            def e2e_p01(payload: bytes) -> int:
                return compute(payload, start) ^ _INVERT

            return cls(byte, e2e_p01)
        algorithm: Callable[[bytes], int] = getattr(crc8, profile)
        return cls(byte, lambda payload: algorithm(prefix + payload))

    def expected(self, data: bytes) -> int:
        """The CRC that ``data`` should carry: over everything but the CRC byte itself."""
        if self.byte == 0:
            return self.compute(data[1:])
        return self.compute(data[: self.byte] + data[self.byte + 1 :])

    def good(self, data: bytes) -> bool:
        """Whether ``data`` carries the CRC that it should."""
        return self.expected(data) == data[self.byte]

    def table(self, length: int) -> list[list[int]]:
        """What each value of each byte changes in :meth:`expected`, (``length`` + 1, 256).

        A CRC is linear but for what it starts from, which is the first number of the last row: the
        exclusive or of that and one number a byte is the CRC of a payload.
        """
        none = self.expected(bytes(length))
        rows = []
        for place in range(length):
            row = [0]
            for bit in range(8):
                one = bytes(place) + bytes((1 << bit,)) + bytes(length - place - 1)
                changed = self.expected(one) ^ none
                row += [before ^ changed for before in row]
            rows.append(row)
        return [*rows, [none] * 256]


def crc_byte(signal: Any) -> int | None:
    """Index of the byte that a cantools signal fills exactly; None if it is no whole byte."""
    first = 0 if signal.byte_order == "little_endian" else 7
    whole = signal.length == 8 and signal.start % 8 == first
    return int(signal.start) // 8 if whole else None


class CounterCheck:
    """Counts the frames missing between two that arrived, by their message counter."""

    __slots__ = ("last", "modulo")

    def __init__(self, modulo: int) -> None:
        self.modulo = modulo
        self.last: int | None = None
        """The counter of the last frame."""

    def advance(self, counter: int) -> int:
        """Cycles since the last frame: 1 in sequence, 0 repeated, n + 1 with n frames lost.

        1 for the first frame. A loss of ``modulo`` frames or more at a stretch shows as the
        remainder only; :class:`~eps_hil.bus.sample_clock.SampleClock` sees those by their time.
        """
        last, self.last = self.last, counter
        return 1 if last is None else (counter - last) % self.modulo


class Seen:
    """The last few frames of a message by their counter: what comes again, and from whom.

    ``period_ns``: the message's cycle; ``modulo``: where its counter wraps.
    """

    __slots__ = ("recent_ns", "ring", "size")

    def __init__(self, modulo: int, period_ns: int) -> None:
        self.size = max(1, min(16, modulo // 2))
        self.recent_ns = self.size * period_ns
        self.ring: list[tuple[int, int, bytes]] = [(-1, 0, b"")] * self.size
        """Counter, stamp and payload at the counter's place."""

    def again(self, t_ns: int, counter: int, data: bytes) -> bool | None:
        """None: a new counter; True: the same frame again, bit for bit; False: other data.

        Other data under a counter that was there a moment ago are another sender's, or the
        sender's counter stands still; either way nobody knows which frame is true.
        """
        place = counter % self.size
        before, stamp, payload = self.ring[place]
        if before == counter and abs(t_ns - stamp) < self.recent_ns:
            self.ring[place] = (counter, t_ns, payload)
            return payload == data
        self.ring[place] = (counter, t_ns, data)
        return None
