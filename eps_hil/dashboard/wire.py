"""How samples travel: from the listener's process to the server's, and from there to pages.

To a page, little endian: ``EPS1``, kind (uint8: 0 goes on, 1 begins anew, 2 answers a question),
three bytes of nothing, number (uint32), buckets n (uint32), begin (float64, s), length of a bucket
(float64, s), then float32: the strips, trace after trace, 2n each; the quantities at one instant,
2n each (:class:`~eps_hil.dashboard.store.Cut`).
"""

import struct
from collections.abc import Iterator, Mapping
from enum import IntEnum

import numpy as np

from eps_hil.dashboard.store import Block, Cut
from eps_hil.dashboard.traces import KEPT

_HEAD = struct.Struct("<4sB3xIIdd")
_BLOCK = struct.Struct("<HI")


class Kind(IntEnum):
    """What a page does with a cut."""

    GOES_ON = 0
    BEGINS = 1
    ANSWERS = 2


def to_page(cut: Cut, kind: Kind, number: int) -> bytes:
    """One binary message of the websocket."""
    head = _HEAD.pack(
        b"EPS1", kind, number, cut.n, cut.begin_ns * 1e-9, cut.bucket_ns * 1e-9
    )  # fmt: skip
    return head + cut.strips.astype("<f4").tobytes() + cut.instants.astype("<f4").tobytes()


def pack(blocks: Mapping[str, Block]) -> bytes:
    """Samples by trace, for the other process."""
    parts = []
    for name, (t_ns, value) in blocks.items():
        parts += [_BLOCK.pack(KEPT.index(name), len(t_ns)), t_ns.tobytes(), value.tobytes()]
    return b"".join(parts)


def unpack(data: bytes) -> dict[str, Block]:
    """What :func:`pack` made."""
    return dict(_blocks(data))


def _blocks(data: bytes) -> Iterator[tuple[str, Block]]:
    place = 0
    while place < len(data):
        which, n = _BLOCK.unpack_from(data, place)
        place += _BLOCK.size
        t_ns = np.frombuffer(data, np.int64, n, place)
        value = np.frombuffer(data, np.float64, n, place + 8 * n)
        place += 16 * n
        yield KEPT[which], (t_ns, value)
