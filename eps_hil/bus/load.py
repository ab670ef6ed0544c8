"""How long frames occupy the bus: bits of classic and CAN FD frames (ISO 11898-1)."""

from eps_hil.bus.frame import Frame

INTERMISSION = 3
EXTENDED_BITS = 20
"""What 29-bit ids add: SRR, IDE, 18 bits, and one reserved bit less the base format's."""


def classic_bits(length: int) -> tuple[int, int]:
    """Bits of a classic base frame of ``length`` bytes: without stuffing, and at most.

    ISO 11898-1: 34 bits and the data are subject to stuffing, 10 bits and the intermission not.
    """
    stuffed = 34 + 8 * length
    plain = stuffed + 10 + INTERMISSION
    return plain, plain + (stuffed - 1) // 4


def fd_seconds(length: int, nominal: float, data: float) -> float:
    """Longest duration of a CAN FD base frame with bit-rate switch (ISO 11898-1:2015), in s.

    Arbitration phase: SOF, id, RRS, IDE, FDF, res, BRS (17 bits, stuffed), then CRC delimiter,
    ACK and its delimiter, EOF (10) and intermission. Data phase: ESI, DLC and data (stuffed),
    stuff count and CRC-17 with fixed stuff bits (4 + 17 + 6; CRC-21 over 16 bytes: 4 + 21 + 7).
    """
    slow = 17 + 4 + 10 + INTERMISSION
    dynamic = 5 + 8 * length
    fast = dynamic + dynamic // 4 + (27 if length <= 16 else 32)
    return slow / nominal + fast / data


def frame_bits(frame: Frame) -> float:
    """Bits of a classic frame with half of the stuff bits that there can be.

    CAN FD frames count as they would without a bit-rate switch: more than they take.
    """
    length = 0 if frame.remote else len(frame.data)
    plain, most = classic_bits(length)
    return (plain + most) / 2 + (EXTENDED_BITS if frame.extended else 0)
