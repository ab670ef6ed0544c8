"""CAN logs of any format -> frames in the order of their stamps, of one bus."""

import heapq
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Protocol

from eps_hil.bus.frame import Frame
from eps_hil.errors import InputError
from eps_hil.recordings.candump import CandumpLog
from eps_hil.recordings.files import check_readable
from eps_hil.recordings.vendor_log import VendorLog

SUFFIXES = (".log", ".blf", ".asc", ".trc", ".mf4")

_NS = 1_000_000_000
LOOK_AHEAD_NS = _NS // 2  # loggers write several buses slightly out of order
_REPORT_EVERY = 4096
_MAX_SHOWN = 8


class _Log(Protocol):
    notes: list[str]

    @property
    def place(self) -> str: ...
    @property
    def fraction(self) -> float: ...
    def __iter__(self) -> Iterator[tuple[str, Frame]]: ...


def read_frames(
    path: str | Path,
    *,
    ids: Collection[int] | None = None,
    channel: str | None = None,
    notes: list[str] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Iterator[Frame]:
    """Yield the frames of a CAN log ordered by stamp (integer ns; of equal ones, as in the file).

    ``ids``: only data frames with these CAN ids; then an id that occurs on two buses is refused,
    since its samples would mix. ``channel``: only this bus of the log.
    ``notes`` receives what was mended. Raises :class:`InputError` for a broken log, for time
    that goes back by more than half a second, and for a log without any frame.
    """
    for _, frame in read_tagged_frames(
        path, ids=ids, channel=channel, notes=notes, on_progress=on_progress
    ):
        yield frame


def read_tagged_frames(
    path: str | Path,
    *,
    ids: Collection[int] | None = None,
    channel: str | None = None,
    notes: list[str] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Iterator[tuple[str, Frame]]:
    """As :func:`read_frames`, each frame with the name of its channel."""
    path = Path(path)
    check_readable(path)
    log: _Log = CandumpLog(path) if path.suffix.lower() == ".log" else VendorLog(path)
    wanted = None if ids is None else frozenset(ids)
    chosen = _of_one_bus(path, _watched(log, on_progress), wanted, channel)
    yield from _ordered(path, log, chosen)
    if notes is not None:
        notes.extend(log.notes)


def read_unordered_frames(
    path: str | Path, on_progress: Callable[[float], None] | None = None
) -> Iterator[tuple[str, Frame]]:
    """All frames with their channel, as they stand in the file: for those who judge its stamps."""
    path = Path(path)
    check_readable(path)
    log: _Log = CandumpLog(path) if path.suffix.lower() == ".log" else VendorLog(path)
    yield from _watched(log, on_progress)


def _watched(log: _Log, on_progress: Callable[[float], None] | None) -> Iterator[tuple[str, Frame]]:
    if on_progress is None:
        yield from log
        return
    for number, tagged in enumerate(log):
        if number % _REPORT_EVERY == 0:
            on_progress(log.fraction)
        yield tagged
    on_progress(1.0)


def _ordered(
    path: Path, log: _Log, frames: Iterator[tuple[str, Frame]]
) -> Iterator[tuple[str, Frame]]:
    waiting: list[tuple[int, int, str, Frame]] = []
    newest = -(2**63)
    moved = 0
    for number, (channel, frame) in enumerate(frames):
        if frame.t_ns < newest:
            moved += 1
            if frame.t_ns < newest - LOOK_AHEAD_NS:
                back_s = (newest - frame.t_ns) / _NS
                problem = f"time goes back by {back_s:.6g} s"
                raise InputError(path, log.place, problem, "split the log there")
        else:
            newest = frame.t_ns
        heapq.heappush(waiting, (frame.t_ns, number, channel, frame))
        while waiting[0][0] < newest - LOOK_AHEAD_NS:
            yield heapq.heappop(waiting)[2:]
    while waiting:
        yield heapq.heappop(waiting)[2:]
    if moved:
        log.notes.append(f"{moved} frames were out of order: sorted by stamp")


def _of_one_bus(
    path: Path,
    frames: Iterator[tuple[str, Frame]],
    ids: frozenset[int] | None,
    wanted: str | None,
) -> Iterator[tuple[str, Frame]]:
    channels: dict[str, None] = {}
    heard_on: dict[tuple[int, bool], str] = {}
    for channel, frame in frames:
        channels.setdefault(channel)
        if wanted is not None and channel != wanted:
            continue
        if ids is None:
            yield channel, frame
        elif frame.can_id in ids and not frame.error and not frame.remote:
            first = heard_on.setdefault((frame.can_id, frame.extended), channel)
            if first != channel:
                problem = f"id 0x{frame.can_id:X} is on channel {first} and on {channel}"
                raise InputError(path, "", problem, "choose one with --channel")
            yield channel, frame
    if not channels:
        raise InputError(path, "", "holds no CAN frame", "check that it is a CAN log")
    if wanted is not None and wanted not in channels:
        names = ", ".join(list(channels)[:_MAX_SHOWN])
        raise InputError(path, f"channel {wanted}", "does not occur", f"the log has: {names}")
