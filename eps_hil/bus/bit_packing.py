"""Raw numbers into a payload and out of it by shifts alone, for messages of plain integers.

cantools takes some ten times as long for the same bytes, and the answer to a sync frame waits for
them. The tests hold the two against each other. Multiplexed messages, floats, and messages whose
signals lie in both byte orders are left to cantools.
"""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple


class Packing(NamedTuple):
    """``fields``: (name, shift, mask, sign) in the number that the payload is in byte order
    ``order``; ``sign``: the sign bit of the raw number, 0 where it has none. ``places``: the same
    by name.
    """

    length: int
    order: Literal["little", "big"]
    fields: tuple[tuple[str, int, int, int], ...]
    places: Mapping[str | None, tuple[int, int, int]]

    def pack(self, raw: Mapping[str, int | float]) -> bytes:
        """The payload; bits that no signal has are 0."""
        number = 0
        for name, shift, mask, _ in self.fields:
            number |= (int(raw[name]) & mask) << shift
        return number.to_bytes(self.length, self.order)

    def unpack(self, data: bytes) -> dict[str, int]:
        """The raw numbers of a payload of ``length`` bytes."""
        number = int.from_bytes(data, self.order)
        return {
            name: (number >> shift & mask ^ sign) - sign for name, shift, mask, sign in self.fields
        }


def packing_of(message: Any) -> Packing | None:
    """How a cantools message is packed; None where shifts alone do not do it."""
    signals = message.signals
    orders = {signal.byte_order for signal in signals}
    if len(orders) != 1 or message.is_multiplexed() or any(s.is_float for s in signals):
        return None
    little = orders == {"little_endian"}
    fields = []
    for signal in signals:
        start, width = int(signal.start), int(signal.length)
        if not little:  # counted from the payload's end; ``start`` is the signal's highest bit
            start = 8 * (message.length - start // 8 - 1) + start % 8 - width + 1
        if start < 0 or start + width > 8 * message.length:
            return None
        sign = 1 << width - 1 if signal.is_signed else 0
        fields.append((signal.name, start, (1 << width) - 1, sign))
    places = {name: (shift, mask, sign) for name, shift, mask, sign in fields}
    return Packing(message.length, "little" if little else "big", tuple(fields), places)
