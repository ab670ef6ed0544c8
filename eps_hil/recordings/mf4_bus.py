"""CAN frames -> MF4 bus logging, as ASAM's standard for it has them, through asammdf.

``extract_bus_logging`` of asammdf decodes such a file, as do the vendors' tools; our own readers
take it as a CAN log. Databases that are given go into the file as attachments.
"""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.bus.frame import Frame
from eps_hil.recordings.channel_numbers import ChannelNumbers
from eps_hil.recordings.files import needs_extra
from eps_hil.recordings.mf4_file import about_file, epoch_of, quiet

_NS = 1_000_000_000
_CHUNK = 50_000
"""Frames that are held in memory; the file's buffers are on the disk."""
DATA, ERROR, REMOTE = "CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame"
_DLC = {length: dlc for dlc, length in enumerate((*range(9), 12, 16, 20, 24, 32, 48, 64))}
_LONG, _SHORT = 64, 8
Rows = npt.NDArray[np.void]


def write_bus_mf4(
    path: Path,
    frames: Iterable[tuple[str, Frame]],
    channels: ChannelNumbers,
    dbc: Sequence[Path] = (),
    source: str = "",
) -> int:
    """Frames with their channels, in the order of their stamps, to ``path``; how many there were.

    ``channels`` numbers them; the group's comment says which name a number was. Data bytes are 64
    wide from the first CAN FD frame's part of the log on.
    """
    with needs_extra(path, "mf4"):
        from asammdf import MDF
    tagged = iter(frames)
    first = next(tagged, None)
    if first is None:
        return 0
    start_ns = epoch_of(first[1].t_ns)
    count = 0
    with quiet(), MDF(version="4.10") as mdf:
        mdf.header.abs_time = start_ns
        groups: dict[tuple[str, int], int] = {}
        for part in _parts(itertools.chain([first], tagged)):
            count += len(part)
            for key, chosen in _by_kind(part).items():
                t_s, rows = _rows(key, chosen, start_ns, channels)
                if key in groups:
                    mdf.extend(groups[key], [(t_s, None), (rows, None)])
                else:
                    groups[key] = _append(mdf, key[0], t_s, rows)
        for index in groups.values():
            mdf.groups[index].channel_group.comment = channels.told()
        for database in dbc:
            mdf.attach(database.read_bytes(), file_name=database.name, comment="CAN database")
        mdf.header.comment = about_file(source)
        mdf.save(path, overwrite=True, compression=2)
    return count


def _parts(frames: Iterator[tuple[str, Frame]]) -> Iterator[list[tuple[str, Frame]]]:
    while part := list(itertools.islice(frames, _CHUNK)):
        yield part


def _by_kind(
    part: list[tuple[str, Frame]],
) -> dict[tuple[str, int], list[tuple[str, Frame]]]:
    """By what they are and how long their data may be."""
    found: dict[tuple[str, int], list[tuple[str, Frame]]] = {}
    for tagged in part:
        frame = tagged[1]
        kind = ERROR if frame.error else REMOTE if frame.remote else DATA
        width = _LONG if frame.fd or len(frame.data) > _SHORT else _SHORT
        found.setdefault((kind, 0 if kind == REMOTE else width), []).append(tagged)
    return found


def _rows(
    key: tuple[str, int], part: list[tuple[str, Frame]], start_ns: int, channels: ChannelNumbers
) -> tuple[npt.NDArray[np.float64], Rows]:
    kind, width = key
    frames = [frame for _, frame in part]
    fields: list[tuple[str, Any]] = [
        ("BusChannel", [channels.number(name) for name, _ in part]),
        ("ID", [frame.can_id for frame in frames]),
        ("IDE", [frame.extended for frame in frames]),
        ("DLC", [frame.remote_length or _DLC.get(len(frame.data), 0) for frame in frames]),
        ("DataLength", [len(frame.data) for frame in frames]),
        ("Dir", [frame.own for frame in frames]),
    ]
    if width:
        data = b"".join(frame.data.ljust(width, b"\0") for frame in frames)
        fields += [
            ("DataBytes", np.frombuffer(data, np.uint8).reshape(-1, width)),
            ("EDL", [frame.fd for frame in frames]),
            ("BRS", [frame.brs for frame in frames]),
            ("ESI", [frame.esi for frame in frames]),
        ]
    kinds: list[Any] = [
        (f"{kind}.{name}", "<u4" if name == "ID" else "u1", (width,) if name == "DataBytes" else ())
        for name, _ in fields
    ]
    rows = np.zeros(len(frames), dtype=kinds)
    for name, values in fields:
        rows[f"{kind}.{name}"] = values
    t_ns = np.array([frame.t_ns for frame in frames], np.int64)
    return (t_ns - start_ns) / _NS, rows


def _append(mdf: Any, kind: str, t_s: npt.NDArray[np.float64], rows: Rows) -> int:
    from asammdf import Signal
    from asammdf.blocks import v4_constants
    from asammdf.blocks.source_utils import Source

    bus = Source("CAN", "CAN", "", v4_constants.SOURCE_BUS, v4_constants.BUS_TYPE_CAN)
    signal = Signal(rows, t_s, name=kind, source=bus)
    index = mdf.append(signal, acq_name="CAN", acq_source=bus)
    return int(index)
