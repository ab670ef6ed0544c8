"""Payloads read and changed bit by bit, by the database, and none of it by the service's decoder.

The harness needs a reader of the published frames that shares no code with what it examines, and
frames whose content is wrong but whose CRC is right. Little-endian integer signals only, which is
what ``dbc/eps_rig.dbc`` has.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

_POLYNOMIAL = 0x1D  # CRC-8 SAE J1850


def _table() -> bytes:
    entries = []
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = (value << 1) ^ _POLYNOMIAL if value & 0x80 else value << 1
        entries.append(value & 0xFF)
    return bytes(entries)


_TABLE = _table()


def crc8(data: bytes, start: int = 0) -> int:
    """CRC-8 SAE J1850 as AUTOSAR E2E profile 1 has it: start value 0, no final XOR."""
    for byte in data:
        start = _TABLE[start ^ byte]
    return start


class Field(NamedTuple):
    """Where a signal is in the payload read as one little-endian number, and its scale."""

    shift: int
    mask: int
    sign: int  # the sign bit, 0: unsigned
    scale: float
    offset: float

    def raw(self, number: int) -> int:
        """The signal's raw number."""
        bits = number >> self.shift & self.mask
        return bits - (self.mask + 1) if bits & self.sign else bits

    @property
    def not_available(self) -> int:
        """The raw number by which a signed signal says that it has no value: its least."""
        return -(self.mask + 1) // 2

    def value(self, number: int) -> float:
        """The signal in the DBC's unit."""
        return self.raw(number) * self.scale + self.offset

    def put(self, number: int, raw: int) -> int:
        """``number`` with the signal replaced; the raw number is clipped to its width."""
        high = self.mask >> 1 if self.sign else self.mask
        raw = min(max(raw, -high - 1 if self.sign else 0), high)
        return number & ~(self.mask << self.shift) | (raw & self.mask) << self.shift


@dataclass(frozen=True, slots=True)
class Layout:
    """One message: its fields by name, and the data id that goes into its CRC (byte 0)."""

    can_id: int
    length: int
    fields: dict[str, Field]
    data_id: int

    @classmethod
    def of(cls, message: Any) -> "Layout":
        """From a cantools message with signals Crc and Counter; ``ValueError`` for another kind."""
        fields = {}
        for signal in message.signals:
            if signal.byte_order != "little_endian" or signal.is_float:
                raise ValueError(f"{message.name}.{signal.name} is no little-endian integer")
            mask = (1 << signal.length) - 1
            sign = 1 << signal.length - 1 if signal.is_signed else 0
            fields[signal.name] = Field(
                signal.start, mask, sign, float(signal.scale), float(signal.offset)
            )
        data_id = message.dbc.attributes.get("CrcDataId")
        return cls(
            message.frame_id,
            message.length,
            fields,
            message.frame_id if data_id is None else int(data_id.value),
        )

    def crc_of(self, data: bytes) -> int:
        """What byte 0 must be."""
        return crc8(data[1 : self.length], crc8(self.data_id.to_bytes(2, "little")))

    def with_raw(self, data: bytes, **raws: int) -> bytes:
        """The payload with some raw numbers replaced and its CRC made right again."""
        number = int.from_bytes(data, "little")
        for name, raw in raws.items():
            number = self.fields[name].put(number, raw)
        changed = number.to_bytes(self.length, "little")
        return bytes((self.crc_of(changed),)) + changed[1:]

    def raw(self, data: bytes, name: str) -> int:
        """One raw number."""
        return self.fields[name].raw(int.from_bytes(data, "little"))

    def value(self, data: bytes, name: str) -> float:
        """One signal in the DBC's unit."""
        return self.fields[name].value(int.from_bytes(data, "little"))
