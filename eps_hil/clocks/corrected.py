"""A copy of a CAN log with the clocks put right: steps taken out, channels on one clock."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from eps_hil.bus.frame import Frame
from eps_hil.clocks.audit import Audit
from eps_hil.clocks.stamps import Stamps
from eps_hil.errors import InputError
from eps_hil.growing import blocks
from eps_hil.recordings.can_log import LOOK_AHEAD_NS, read_unordered_frames
from eps_hil.recordings.conversion import LOG_SUFFIXES, write_log

_NS = 1_000_000_000
_SUFFIXES = (*LOG_SUFFIXES, ".mf4")


def check_suffix(target: Path) -> None:
    """:class:`InputError` for a format that no CAN log can be written in."""
    if target.suffix.lower() not in _SUFFIXES:
        known = ", ".join(_SUFFIXES)
        problem = f"suffix '{target.suffix}' is no CAN log that can be written"
        raise InputError(target, "--out", problem, f"use {known}")


def corrected_stamps(found: Audit) -> dict[str, Stamps]:
    """By channel, for its frames in the order of the file: what the reference's clock would say.

    A channel without a frame in common with the reference loses its steps, no more: nothing ties
    its clock to the other.
    """
    channels = {one.channel.name: one.straight for one in found.channels}
    stamps = {name: one.t_ns for name, one in channels.items()}
    start_ns = int(channels[found.reference].t_ns[0])
    for pair in found.pairs:
        stamps[pair.channel] = pair.on_reference(stamps[pair.channel], start_ns)
    return stamps


def write_corrected(
    found: Audit,
    target: Path,
    on_progress: Callable[[float], None] | None = None,
    notes: list[str] | None = None,
) -> int:
    """Write the copy, in the order of the corrected stamps; return its number of frames.

    Frames of one channel stay in the order of the file. ``notes`` hears which bus has which number.
    :class:`InputError` where one clock went back and by how much could not be told.
    """
    check_suffix(target)
    stamps_of = corrected_stamps(found)
    _check_rising(found, stamps_of)
    tagged = read_unordered_frames(found.path, on_progress)
    start_ns = min(int(t_ns[0]) for t_ns in stamps_of.values())
    put_right = _in_step(found.path, tagged, stamps_of)
    count, told = write_log(target, put_right, start_ns, found.path.name)
    if notes is not None:
        notes += told
    return count


def _check_rising(found: Audit, stamps_of: Mapping[str, Stamps]) -> None:
    for name, t_ns in stamps_of.items():
        back_ns = int(np.max(np.maximum.accumulate(t_ns) - t_ns, initial=0))
        if back_ns > LOOK_AHEAD_NS:
            problem = f"the clock of {name} goes back by {back_ns / _NS:.6g} s or more"
            remedy = "no cyclic message tells by how much: split the log there"
            raise InputError(found.path, "--out", problem, remedy)


def _in_step(
    path: Path, tagged: Iterator[tuple[str, Frame]], stamps_of: Mapping[str, Stamps]
) -> Iterator[tuple[str, Frame]]:
    """The frames of the file with their corrected stamps, in the order of these.

    Held are those that wait for another channel's: as many as the clocks are apart.
    """
    numbered = enumerate(tagged)
    waiting: dict[str, deque[tuple[int, Frame]]] = {name: deque() for name in stamps_of}
    following = {name: _places(t_ns) for name, t_ns in stamps_of.items()}
    due = {name: next(places) for name, places in following.items()}
    while due:
        place = min(at for at, _ in due.values())
        first = [name for name, (at, _) in due.items() if at == place]
        if there := [name for name in first if waiting[name]]:
            name = min(there, key=lambda one: waiting[one][0][0])
            frame = waiting[name].popleft()[1]
        else:
            name, frame = _next_of(path, numbered, first, waiting)
        yield name, replace(frame, t_ns=due[name][1])
        if (after := next(following[name], None)) is None:
            del due[name]
        else:
            due[name] = after


def _next_of(
    path: Path,
    numbered: Iterator[tuple[int, tuple[str, Frame]]],
    wanted: Sequence[str],
    waiting: Mapping[str, deque[tuple[int, Frame]]],
) -> tuple[str, Frame]:
    """The next frame of these channels; those of others before it wait."""
    for number, (name, frame) in numbered:
        if name in wanted:
            return name, frame
        if name in waiting:
            waiting[name].append((number, frame))
    raise InputError(path, "", "changed while it was read", "write the copy again")


def _places(t_ns: Stamps) -> Iterator[tuple[int, int]]:
    """Where each frame of a channel goes, and its stamp: one that is early stays behind others."""
    latest = -(2**63)
    for some in blocks(len(t_ns)):
        for stamp in t_ns[some].tolist():
            latest = max(latest, stamp)
            yield latest, stamp
