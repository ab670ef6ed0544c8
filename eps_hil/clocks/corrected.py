"""A copy of a CAN log with the clocks put right: steps taken out, channels on one clock."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from eps_hil.bus.frame import Frame
from eps_hil.clocks.audit import Audit
from eps_hil.clocks.cadence import Line
from eps_hil.errors import InputError
from eps_hil.recordings.can_log import read_unordered_frames
from eps_hil.recordings.conversion import LOG_SUFFIXES, as_message, log_writer
from eps_hil.recordings.files import replacing
from eps_hil.recordings.mf4_bus import write_bus_mf4

_NS = 1_000_000_000
_SUFFIXES = (*LOG_SUFFIXES, ".mf4")


def check_suffix(target: Path) -> None:
    """:class:`InputError` for a format that no CAN log can be written in."""
    if target.suffix.lower() not in _SUFFIXES:
        known = ", ".join(_SUFFIXES)
        problem = f"suffix '{target.suffix}' is no CAN log that can be written"
        raise InputError(target, "--out", problem, f"use {known}")


def correction(found: Audit) -> Callable[[str, np.ndarray], np.ndarray]:
    """``correct(channel, t_ns)``: stamps (n,) in ns -> what the reference's clock would say.

    The reference's own steps are taken out first. A channel without a frame in common with the
    reference loses its steps, no more: nothing ties its clock to the other.
    """
    steps = {one.channel.name: one.steps for one in found.channels}
    lines: dict[str, Line] = {one.channel: one.line for one in found.pairs}

    def correct(channel: str, t_ns: np.ndarray) -> np.ndarray:
        at_s = (t_ns - found.start_ns) * 1e-9
        late_s = np.zeros(len(t_ns))
        if channel in lines:  # its difference to the reference has the steps of both
            late_s += lines[channel].at(at_s)
            on = steps[found.reference]
        else:
            on = steps[channel]
        for step in on:
            late_s += step.by_s * (at_s >= step.at_s)
        return np.asarray(t_ns - np.round(late_s * _NS).astype(np.int64))

    return correct


def write_corrected(
    found: Audit, target: Path, on_progress: Callable[[float], None] | None = None
) -> int:
    """Write the copy, in the order of the corrected stamps; return its number of frames."""
    check_suffix(target)
    tagged = list(read_unordered_frames(found.path, on_progress))
    correct = correction(found)
    stamps = np.array([frame.t_ns for _, frame in tagged], dtype=np.int64)
    names = np.array([name for name, _ in tagged])
    for name in dict.fromkeys(names.tolist()):
        stamps[names == name] = correct(str(name), stamps[names == name])
    order = np.argsort(stamps, kind="stable").tolist()
    source = found.path.suffix.lower()
    with replacing(target) as temporary:
        if target.suffix.lower() == ".mf4":
            put_right = ((tagged[k][0], _at(tagged[k][1], int(stamps[k]))) for k in order)
            return write_bus_mf4(temporary, put_right, source=found.path.name)
        writer = log_writer(temporary, target.suffix.lower(), int(stamps[order[0]]) / _NS)
        try:
            for k in order:
                name, frame = tagged[k]
                writer.on_message_received(as_message(_at(frame, int(stamps[k])), name, source))
        finally:
            writer.stop()
    return len(tagged)


def _at(frame: Frame, t_ns: int) -> Frame:
    return replace(frame, t_ns=t_ns)
