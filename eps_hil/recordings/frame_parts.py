"""Parts of a log, as its format's reader finds them, and the columns that they make together."""

from collections.abc import Callable, Collection
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.bus.frame_columns import FrameColumns
from eps_hil.recordings.can_log import LOOK_AHEAD_NS
from eps_hil.recordings.candump import ID_MASK

Ints = npt.NDArray[np.int64]
Keep = Callable[[Ints, bytes], npt.NDArray[np.bool_]]
"""Which of some keys (n,) on a channel are wanted."""


class Part(NamedTuple):
    """Data frames of one channel, as of :class:`FrameColumns`; ``place`` (n,): their order."""

    place: Ints
    channel: bytes
    t_ns: Ints
    key: Ints
    length: Ints
    data: npt.NDArray[np.uint8]


def wanted(ids: Collection[int], channel: str | None) -> Keep:
    """Frames with these ids, of any format, on that channel or on any."""
    known = np.array(sorted(ids), np.int64)
    only = None if channel is None else channel.encode("latin-1", "replace")

    def keep(keys: Ints, on: bytes) -> npt.NDArray[np.bool_]:
        if only is not None and on != only:
            return np.zeros(len(keys), bool)
        return np.isin(keys & ID_MASK, known)

    return keep


class InOrder:
    """Parts in as they stand in a log; frames out by stamp, once nothing earlier can come."""

    def __init__(self) -> None:
        self._heard: dict[int, bytes] = {}
        self._newest = np.iinfo(np.int64).min
        self._waiting: FrameColumns | None = None
        self.moved = 0

    def add(self, parts: list[Part]) -> FrameColumns | None:
        """Frames that can be told; None where the log is to be refused.

        So it is where time goes back, or one id is on two channels.
        """
        if self._mixed(parts):
            return None
        order = np.argsort(np.concatenate([part.place for part in parts]), kind="stable")
        came = _together(parts, order)
        newest = np.maximum.accumulate(np.maximum(came.t_ns, self._newest))
        if (came.t_ns < newest - LOOK_AHEAD_NS).any():
            return None
        self.moved += int(np.count_nonzero(came.t_ns < newest))
        self._newest = int(newest[-1])
        frames = came if self._waiting is None else _joined(self._waiting, came)
        if (np.diff(frames.t_ns) < 0).any():
            frames = _rows(frames, np.argsort(frames.t_ns, kind="stable"))
        until = int(np.searchsorted(frames.t_ns, self._newest - LOOK_AHEAD_NS))
        self._waiting = _rows(frames, slice(until, None), copied=True)
        return _rows(frames, slice(until))

    def rest(self) -> FrameColumns | None:
        """Those that waited for earlier ones; None if there was no frame at all."""
        return self._waiting

    def _mixed(self, parts: list[Part]) -> bool:
        """Whether one id is on two channels."""
        for part in parts:
            for key in np.unique(part.key).tolist():
                if self._heard.setdefault(key, part.channel) != part.channel:
                    return True
        return False


def _together(parts: list[Part], order: Ints) -> FrameColumns:
    widest = max(part.data.shape[1] for part in parts)
    t_ns = np.concatenate([part.t_ns for part in parts])
    data = np.zeros((len(t_ns), widest), np.uint8)
    since = 0
    for part in parts:
        data[since : since + len(part.key), : part.data.shape[1]] = part.data
        since += len(part.key)
    key = np.concatenate([part.key for part in parts])
    length = np.concatenate([part.length for part in parts])
    return _rows(FrameColumns(t_ns, key, length, data), order)


def _joined(one: FrameColumns, other: FrameColumns) -> FrameColumns:
    widest = max(one.data.shape[1], other.data.shape[1])
    wide = (np.pad(d, ((0, 0), (0, widest - d.shape[1]))) for d in (one.data, other.data))
    return FrameColumns(
        np.concatenate((one.t_ns, other.t_ns)),
        np.concatenate((one.key, other.key)),
        np.concatenate((one.length, other.length)),
        np.concatenate(tuple(wide)),
    )


def _rows(frames: FrameColumns, rows: Ints | slice, *, copied: bool = False) -> FrameColumns:
    """Some frames; ``copied``: so that the others can be forgotten."""
    t_ns, key, length = frames.t_ns[rows], frames.key[rows], frames.length[rows]
    if copied:
        t_ns, key, length = t_ns.copy(), key.copy(), length.copy()
    data = frames.data[rows]
    return FrameColumns(t_ns, key, length, data.copy() if copied else data)
