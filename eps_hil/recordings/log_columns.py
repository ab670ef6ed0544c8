"""CAN logs read at once, where their format has a reader for that; all others frame by frame."""

from collections.abc import Callable, Collection
from pathlib import Path

from eps_hil.bus.frame_columns import FrameColumns

SUFFIXES = (".log", ".blf", ".mf4")


def read_columns_of(
    path: Path,
    *,
    ids: Collection[int],
    channel: str | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> tuple[FrameColumns, list[str]] | None:
    """The wanted frames of a log, and notes; None: read it frame by frame.

    None too for whatever is refused there, which then says why.
    """
    from eps_hil.recordings.blf_columns import BlfColumns
    from eps_hil.recordings.candump_columns import CandumpColumns
    from eps_hil.recordings.frame_parts import Part, together, wanted
    from eps_hil.recordings.mf4_columns import Mf4Columns

    keep = wanted(ids, channel)
    readers: dict[str, type[BlfColumns | CandumpColumns | Mf4Columns]]
    readers = {".blf": BlfColumns, ".mf4": Mf4Columns}
    log = readers.get(path.suffix.lower(), CandumpColumns)(path, keep=keep)
    parts: list[Part] = []
    for found in log.parts(on_progress):
        if found is None:
            return None
        parts += found
    notes = list(log.notes)
    frames = together(parts, notes)
    return None if frames is None else (frames, notes)
