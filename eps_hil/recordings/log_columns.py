"""CAN logs read many frames at once, where their format has a reader for that.

A piece of the log at a time: what is held is one piece, and what waits for earlier stamps.
"""

from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from eps_hil.bus.frame_columns import FrameColumns

SUFFIXES = (".log", ".blf", ".mf4")
PIECE = 1 << 18
"""Frames that are told at once, or a little more."""


def pieces_of(
    path: Path,
    *,
    ids: Collection[int],
    notes: list[str],
    channel: str | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Iterator[FrameColumns | None]:
    """The wanted frames of a log in order; None (and nothing more): read it frame by frame.

    None too for whatever is refused there, which then says why. ``notes`` hears what was mended.
    """
    from eps_hil.recordings.blf_columns import BlfColumns
    from eps_hil.recordings.candump_columns import CandumpColumns
    from eps_hil.recordings.frame_parts import InOrder, Part, wanted
    from eps_hil.recordings.mf4_columns import Mf4Columns

    readers: dict[str, type[BlfColumns | CandumpColumns | Mf4Columns]]
    readers = {".blf": BlfColumns, ".mf4": Mf4Columns}
    log = readers.get(path.suffix.lower(), CandumpColumns)(path, keep=wanted(ids, channel))
    in_order = InOrder()
    parts: list[Part] = []
    for found in log.parts(on_progress):
        if found is None:
            yield None
            return
        parts += found
        if log.in_order and sum(len(part.key) for part in parts) >= PIECE:
            piece = in_order.add(parts)
            yield piece
            if piece is None:
                return
            parts = []
    if parts:
        piece = in_order.add(parts)
        yield piece
        if piece is None:
            return
    yield in_order.rest()
    notes += log.notes
    if in_order.moved:
        notes.append(f"{in_order.moved} frames were out of order: sorted by stamp")
