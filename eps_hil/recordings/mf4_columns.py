"""MF4 bus logging read at once: the records of each group of CAN frames as arrays.

What a record holds, and how its stamp is rounded, is as in python-can's reader and
:mod:`~eps_hil.recordings.vendor_log`. Files with anything else (stamps of a group that go back,
payloads that are no bytes, a file that asammdf does not read) are left to these: None is returned.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.bus.frame_columns import EXTENDED
from eps_hil.recordings.candump import ID_MASK
from eps_hil.recordings.files import needs_extra
from eps_hil.recordings.frame_parts import Keep, Part
from eps_hil.recordings.mf4_ids import extended
from eps_hil.recordings.vendor_log import quiet_libraries

_CHUNK = 200_000
_FRAME = "CAN_DataFrame"
_RELATIVE_S = 1e6
_BUS_EVENT = 1 << 1  # ASAM MDF 4.1, flags of a channel group
_BUS, _CAN = 2, 2  # ASAM MDF 4.1, kinds of source and of bus

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


class Mf4Columns:
    """One log, group by group of its frames, in chunks of their records."""

    def __init__(self, path: Path, *, keep: Keep) -> None:
        self._path, self._keep = path, keep
        self.notes: list[str] = []
        self.in_order = True

    def parts(self, on_progress: Callable[[float], None] | None) -> Iterator[list[Part] | None]:
        """What each chunk holds; None (and nothing after it) where one is not plain."""
        with needs_extra(self._path, "mf4"):
            import asammdf
        opened: Any = asammdf.MDF  # its annotations leave the option out
        with quiet_libraries():
            try:
                with opened(self._path, process_bus_logging=False) as mdf:
                    yield from self._groups(mdf, on_progress)
            except Exception:  # what is wrong with it, the reader by frames says
                yield None

    def _groups(
        self, mdf: Any, on_progress: Callable[[float], None] | None
    ) -> Iterator[list[Part] | None]:
        start_s = mdf.header.start_time.timestamp()
        groups = [index for index, group in enumerate(mdf.groups) if has_frames(group)]
        records = {index: mdf.groups[index].channel_group.cycles_nr for index in groups}
        done, whole = 0, max(sum(records.values()), 1)
        self.in_order = alone = len(groups) == 1
        for index in groups:
            newest_s = -np.inf
            for since in range(0, records[index], _CHUNK):
                found = mdf.get(_FRAME, index, record_offset=since, record_count=_CHUNK, raw=False)
                seconds = found.timestamps.astype(np.float64) + start_s
                place = done + np.arange(len(seconds))
                done += len(seconds)
                if not alone:
                    if seconds[0] < newest_s or (np.diff(seconds) < 0).any():
                        yield None
                        return
                    newest_s = float(seconds[-1])
                    place = _in_order(seconds)
                yield self._chunk(found.samples, seconds, place)
                if on_progress is not None:
                    on_progress(done / whole)

    def _chunk(self, samples: npt.NDArray[Any], seconds: Floats, place: Ints) -> list[Part] | None:
        names = samples.dtype.names or ()
        data = samples[f"{_FRAME}.DataBytes"]
        if data.ndim != 2 or data.dtype != np.uint8:
            return None
        key = samples[f"{_FRAME}.ID"].astype(np.int64) & ID_MASK
        key |= np.where(extended(samples, _FRAME), EXTENDED, 0)
        length = np.minimum(samples[f"{_FRAME}.DataLength"].astype(np.int64), data.shape[1])
        there = f"{_FRAME}.BusChannel" in names
        channel = samples[f"{_FRAME}.BusChannel"].astype(np.int64) if there else None
        numbers = [None] if channel is None else np.unique(channel).tolist()
        if len(numbers) > 1 and (np.diff(place) == 0).any():
            return None  # frames of one stamp stand in the order of the file, on all channels
        t_ns = stamps_ns(seconds)
        parts = []
        for number in numbers:
            name = str(number).encode()
            mine = np.arange(len(key)) if channel is None else np.flatnonzero(channel == number)
            mine = mine[self._keep(key[mine], name)]
            if len(mine):
                widest = int(length[mine].max())
                content = data[mine, :widest].copy()
                content[np.arange(widest) >= length[mine, np.newaxis]] = 0
                parts.append(Part(place[mine], name, t_ns[mine], key[mine], length[mine], content))
        return parts


def stamps_ns(seconds: Floats) -> Ints:
    """Stamps as :mod:`~eps_hil.recordings.vendor_log` rounds them: those of an epoch to the us."""
    exact = np.abs(seconds) < _RELATIVE_S
    nearest_us = np.rint(seconds * 1e6).astype(np.int64) * 1000
    return np.where(exact, np.rint(seconds * 1e9).astype(np.int64), nearest_us)


def _in_order(seconds: Floats) -> Ints:
    """Whole numbers (n,) in the order of stamps (n,) in seconds, equal for equal ones."""
    bits = np.ascontiguousarray(seconds + 0.0).view(np.int64)
    return np.where(bits < 0, np.iinfo(np.int64).min - bits, bits)


def has_frames(group: Any) -> bool:
    """Whether an open file's channel group holds CAN data frames (asammdf's ``Group``)."""
    about = group.channel_group
    source = about.acq_source
    return bool(
        about.flags & _BUS_EVENT
        and about.cycles_nr
        and source is not None
        and source.source_type & _BUS
        and source.bus_type == _CAN
        and any(channel.name == _FRAME for channel in group.channels)
    )
