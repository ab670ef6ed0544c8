"""A copy of a CAN log with the clocks put right: steps taken out, channels on one clock."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from eps_hil.bus.frame import Frame
from eps_hil.clocks.audit import Audit
from eps_hil.clocks.stamps import Stamps
from eps_hil.errors import InputError
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
    tagged = list(read_unordered_frames(found.path, on_progress))
    stamps = np.zeros(len(tagged), dtype=np.int64)
    place = np.zeros(len(tagged), dtype=np.int64)
    names = np.array([name for name, _ in tagged])
    for name, t_ns in stamps_of.items():
        stamps[names == name] = t_ns
        place[names == name] = np.maximum.accumulate(t_ns)
    order = np.argsort(place, kind="stable").tolist()
    put_right = ((tagged[k][0], _at(tagged[k][1], int(stamps[k]))) for k in order)
    count, told = write_log(target, put_right, int(stamps[order[0]]), found.path.name)
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


def _at(frame: Frame, t_ns: int) -> Frame:
    return replace(frame, t_ns=t_ns)
