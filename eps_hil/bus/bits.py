"""One signal's raw numbers out of many payloads at once, wherever the database puts it."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

_WHOLE_BYTES = 8
_FLOATS = {16: (np.uint16, np.float16), 32: (np.uint32, np.float32), 64: (np.uint64, np.float64)}


class Bits(NamedTuple):
    """``columns``: bytes of the payload, lowest first; ``shift``: bits below the signal's there."""

    columns: tuple[int, ...]
    shift: int
    width: int
    signed: bool
    real: bool

    def raw(self, data: npt.NDArray[np.uint8]) -> npt.NDArray[Any]:
        """Raw numbers of payloads (n, length), (n,): int64, uint64 for 64 bits without a sign,
        float64 where the database says that they are floats."""
        bits = np.zeros(len(data), np.uint64)
        for place, column in enumerate(self.columns):
            bits |= data[:, column].astype(np.uint64) << np.uint64(8 * place)
        bits >>= np.uint64(self.shift)
        bits &= np.uint64((1 << self.width) - 1)
        if self.real:
            whole, real = _FLOATS[self.width]
            return bits.astype(whole).view(real).astype(np.float64)
        if self.signed:
            sign = np.uint64(1 << self.width - 1)
            return ((bits ^ sign) - sign).view(np.int64)
        return bits if self.width == 64 else bits.view(np.int64)


def bits_of(signal: Any, length: int) -> Bits | None:
    """Where a cantools signal lies in a message of ``length`` bytes.

    None where it leaves the message, or lies in more than eight of its bytes.
    """
    start, width = int(signal.start), int(signal.length)
    little = signal.byte_order == "little_endian"
    if not little:  # counted from the payload's end; ``start`` is the signal's highest bit
        start = 8 * (length - start // 8 - 1) + start % 8 - width + 1
    if start < 0 or start + width > 8 * length:
        return None
    columns = range(start // 8, (start + width - 1) // 8 + 1)
    if len(columns) > _WHOLE_BYTES or (signal.is_float and width not in _FLOATS):
        return None
    places = tuple(columns) if little else tuple(length - 1 - column for column in columns)
    return Bits(places, start % 8, width, bool(signal.is_signed), bool(signal.is_float))
