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


def together(parts: list[Part], notes: list[str]) -> FrameColumns | None:
    """All frames by stamp, and a note if they were not; None where the log is to be refused.

    So it is where it has none of them, time goes back, or one id is on two channels.
    """
    if not parts or _mixed(parts):
        return None
    order = np.argsort(np.concatenate([part.place for part in parts]), kind="stable")
    t_ns = np.concatenate([part.t_ns for part in parts])[order]
    newest = np.maximum.accumulate(t_ns)
    if (newest - t_ns).max() > LOOK_AHEAD_NS:
        return None
    moved = int(np.count_nonzero(t_ns < newest))
    if moved:
        by_time = np.argsort(t_ns, kind="stable")
        order, t_ns = order[by_time], t_ns[by_time]
        notes.append(f"{moved} frames were out of order: sorted by stamp")
    widest = max(part.data.shape[1] for part in parts)
    data = np.zeros((len(t_ns), widest), np.uint8)
    since = 0
    for part in parts:
        data[since : since + len(part.key), : part.data.shape[1]] = part.data
        since += len(part.key)
    key = np.concatenate([part.key for part in parts])
    length = np.concatenate([part.length for part in parts])
    return FrameColumns(t_ns, key[order], length[order], data[order])


def _mixed(parts: list[Part]) -> bool:
    """Whether one id is on two channels."""
    heard: dict[int, bytes] = {}
    for part in parts:
        for key in np.unique(part.key).tolist():
            if heard.setdefault(key, part.channel) != part.channel:
                return True
    return False
