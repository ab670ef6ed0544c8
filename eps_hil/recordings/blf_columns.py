"""BLF logs read at once: containers unpacked whole, their objects walked by one compiled loop.

What an object holds, and how its stamp is rounded, is as in python-can's reader and
:mod:`~eps_hil.recordings.vendor_log`. Files with anything else (a cut-off end, other kinds of
compression, CAN FD objects of type 101) are left to these: None is returned.
"""

import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.bus.frame_columns import EXTENDED
from eps_hil.compiled import kernel
from eps_hil.recordings.candump import ID_MASK
from eps_hil.recordings.files import refused_by_system
from eps_hil.recordings.frame_parts import Keep, Part

_OBJECT = struct.Struct("<4sHHLL")
_CONTAINER = struct.Struct("<H6xL4x")
_LOG_CONTAINER = 10
_PLAIN, _DEFLATED = 0, 2
_SIGNATURE = 0x4A424F4C  # "LOBJ"
_MESSAGE, _MESSAGE_2, _FD, _FD_64 = 1, 86, 100, 101
_SMALLEST = 32  # header and body of the shortest frame
_WIDEST = 64
_RELATIVE_S = 1e6

Ints = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.uint8]


class _Found(NamedTuple):
    """Frames of a block, (n,): raw stamp, whether it counts 10 us, channel, id with flag."""

    stamp: Ints
    coarse: Ints
    channel: Ints
    can_id: Ints
    length: Ints
    data: Bytes


@kernel
def _whole(b: Bytes, at: int, size: int) -> int:
    value = 0
    for k in range(size):
        value |= int(b[at + k]) << 8 * k
    return value


@kernel
def _walk(b: Bytes, found: _Found) -> tuple[int, int]:
    """Objects of a block: (where the rest begins, frames); frames -1 where it is not plain."""
    at, rows, end = 0, 0, len(b)
    while True:
        rest = at
        skipped = 0
        while skipped <= 4 and at + 4 <= end and _whole(b, at, 4) != _SIGNATURE:
            at += 1
            skipped += 1
        if at + 4 > end or skipped > 4:
            return rest, rows if rest + 8 > end else -1
        if at + 16 > end:
            return rest, rows
        version, size, kind = _whole(b, at + 6, 2), _whole(b, at + 8, 4), _whole(b, at + 12, 4)
        after = at + size
        if after > end:
            return rest, rows
        if size < 16 or version not in (1, 2) or kind == _FD_64:
            return rest, -1
        head = at + 16
        body = head + (16 if version == 1 else 24)
        at = after
        if kind not in (_MESSAGE, _MESSAGE_2, _FD):
            continue
        long = kind == _FD
        if body + (84 if long else 16) > after:
            return rest, -1
        if b[body + 2] & 0x80:
            found.channel[rows] = -1  # a remote request
        else:
            found.channel[rows] = _whole(b, body, 2)
        found.coarse[rows] = _whole(b, head, 4) == 1
        found.stamp[rows] = _whole(b, head + 8, 8)
        found.can_id[rows] = _whole(b, body + 4, 4)
        many = b[body + 14] if long else min(b[body + 3], 8)
        if many > _WIDEST:
            return rest, -1
        found.length[rows] = many
        data = body + (20 if long else 8)
        for k in range(_WIDEST):
            found.data[rows, k] = b[data + k] if k < many else 0
        rows += 1


class BlfColumns:
    """One log, container by container."""

    def __init__(self, path: Path, *, keep: Keep) -> None:
        self._path, self._keep = path, keep
        self._frames = 0
        self.notes: list[str] = []
        self.in_order = True

    def parts(self, on_progress: Callable[[float], None] | None) -> Iterator[list[Part] | None]:
        """What each container holds; None (and nothing after it) where one is not plain."""
        import can

        size = max(self._path.stat().st_size, 1)
        rest = b""
        with refused_by_system(self._path), self._path.open("rb") as file:
            try:
                start_ns = round(can.BLFReader(file).start_timestamp * 1000) * 1_000_000
            except Exception:  # what is wrong with it, the reader by frames says
                yield None
                return
            while head := file.read(_OBJECT.size):
                block = self._unpacked(head, file.read)
                if block is None:
                    yield None
                    return
                rest += block
                found, rest = self._block(rest, start_ns)
                yield found
                if on_progress is not None:
                    on_progress(file.tell() / size)

    @staticmethod
    def _unpacked(head: bytes, read: Callable[[int], bytes]) -> bytes | None:
        """Content of the container that begins with ``head``; None where it is none that we know.

        Empty for an object that is no container.
        """
        try:
            signature, _, _, size, kind = _OBJECT.unpack(head)
            body = read(size - _OBJECT.size)
            read(size % 4)
            if signature != b"LOBJ" or len(body) != size - _OBJECT.size:
                return None
            if kind != _LOG_CONTAINER:
                return b""
            method, _ = _CONTAINER.unpack_from(body)
            content = body[_CONTAINER.size :]
            if method == _DEFLATED:
                return zlib.decompressobj().decompress(content)
            return content if method == _PLAIN else None
        except (struct.error, zlib.error):
            return None

    def _block(self, block: bytes, start_ns: int) -> tuple[list[Part] | None, bytes]:
        """The frames of a block, and the bytes of an object that goes on in the next."""
        room = len(block) // _SMALLEST + 1
        whole = [np.zeros(room, np.int64) for _ in range(5)]
        found = _Found(
            whole[0], whole[1], whole[2], whole[3], whole[4], np.empty((room, _WIDEST), np.uint8)
        )
        since, many = _walk(np.frombuffer(block, np.uint8), found)
        if many < 0:
            return None, b""
        found = _Found._make(each[:many] for each in found)
        t_ns = _stamps(found.stamp, found.coarse, start_ns)
        key = np.where(found.can_id >> 31 & 1, found.can_id & ID_MASK | EXTENDED,
                       found.can_id & ID_MASK)  # fmt: skip
        place = self._frames + np.arange(many)
        self._frames += many
        parts = []
        for channel in np.unique(found.channel).tolist():
            name = str(channel).encode()
            mine = np.flatnonzero(found.channel == channel)
            mine = mine[self._keep(key[mine], name)] if channel >= 0 else mine[:0]
            if len(mine):
                widest = int(found.length[mine].max())
                parts.append(
                    Part(place[mine], name, t_ns[mine], key[mine], found.length[mine],
                         found.data[mine, :widest])
                )  # fmt: skip
        return parts, block[since:]


def _stamps(stamp: Ints, coarse: Ints, start_ns: int) -> Ints:
    """Nanoseconds since 1970, or since the start where that is not known."""
    seconds = stamp.astype(np.float64) / np.where(coarse, 1e5, 1e9)
    nearest_us = np.rint(seconds * 1e6).astype(np.int64) * 1000
    if start_ns:
        return start_ns + nearest_us
    exact = np.abs(seconds) < _RELATIVE_S
    return np.where(exact, np.rint(seconds * 1e9).astype(np.int64), nearest_us)
