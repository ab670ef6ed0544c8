"""One recording format to another: tables to tables, CAN logs to tables, CAN logs to CAN logs.

A CAN log becomes MF4 in two ways: as signals, where a mapping is given, else as its raw frames.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.bus.candump_line import candump_line
from eps_hil.bus.frame import Frame
from eps_hil.errors import InputError
from eps_hil.recordings.can_log import read_tagged_frames
from eps_hil.recordings.channel_numbers import ChannelNumbers
from eps_hil.recordings.files import refused_by_system, replacing
from eps_hil.recordings.read import is_can_log, read_columns
from eps_hil.recordings.table import ESTIMATES, MARK_REMEDY
from eps_hil.recordings.write import SERIES_SUFFIXES, write_series
from eps_hil.series import Series

LOG_SUFFIXES = (".log", ".blf", ".asc")
"""CAN logs that can be written. Not TRC: its writer drops CAN FD, remote and error frames."""

_FATE = {".mf4": "marked by their invalidation bits", ".mcap": "left out"}
_NS = 1_000_000_000
_YEAR_1990_S = 631_152_000  # BLF has no date before; python-can then leaves the start out


def convert(
    source: str | Path,
    target: str | Path,
    *,
    dbc: Sequence[Path] = (),
    signals: Path | None = None,
    gaps: str = "refuse",
    ignore_unknown: bool = False,
    channel: str | None = None,
    rate_hz: float | None = None,
    on_progress: Callable[[float], None] | None = None,
    say_written: Callable[[str], None] = lambda _what: None,
) -> tuple[str, ...]:
    """Convert ``source`` to the format that ``target``'s suffix names; return the notes.

    ``say_written`` hears what was written ("6000 rows of motor_torque_nm", "39186 frames").

    Into a table the rows are the union of all time stamps, and a signal has an empty cell where it
    has no sample: read back, every signal has exactly the samples it had (but a frame that was
    lost beside others of its instant is a hole in the table, and is told as one). With ``rate_hz``
    the rows are that many a second and have no holes (:mod:`eps_hil.recordings.common_rate`).
    MF4 and MCAP keep every signal's own samples. Into a CAN log, and from one into MF4 without
    ``signals``, the frames keep their order, channel and (to the microsecond) their stamps; ASC
    counts from its first frame.
    """
    source, target = Path(source), Path(target)
    suffix = target.suffix.lower()
    if suffix not in (*SERIES_SUFFIXES, *LOG_SUFFIXES):
        known = ", ".join((*SERIES_SUFFIXES, *LOG_SUFFIXES))
        raise InputError(target, "", f"suffix '{target.suffix}' cannot be written", f"use {known}")
    with refused_by_system(target):
        same = target.exists() and source.exists() and target.samefile(source)
    if same:
        raise InputError(target, "", "is the input itself", "name another output file")
    raw = suffix == ".mf4" and signals is None and source.exists() and is_can_log(source)
    if raw or suffix in LOG_SUFFIXES:
        if not is_can_log(source):
            problem = "holds columns, which cannot become CAN frames"
            raise InputError(source, "", problem, "convert it to .csv, .parquet, .mf4 or .mcap")
        if rate_hz is not None:
            problem = f"becomes CAN frames in {suffix}, which have no common rate"
            raise InputError(source, "", problem, "leave out --rate, or give --signals")
        return _log_to_log(source, target, channel, on_progress, say_written, dbc)
    series, notes = read_columns(
        source,
        dbc=dbc,
        signals=signals,
        gaps=gaps,
        ignore_unknown=ignore_unknown,
        channel=channel,
        on_progress=on_progress,
    )
    if not series:
        raise InputError(source, "", "no signal has a value", "record at least one")
    if rate_hz is None:
        notes += _told(series, suffix)
    else:
        series, more = _at_rate(source, series, rate_hz, gaps)
        notes += more
    carriers = _carriers(source, signals)
    rows = write_series(target, series, source=source.name, carriers=carriers)
    say_written(f"{rows} rows of {', '.join(series)}")
    return notes


def _at_rate(
    source: Path, series: Mapping[str, Series], rate_hz: float, gaps: str
) -> tuple[dict[str, Series], tuple[str, ...]]:
    from eps_hil.recordings.common_rate import HoleError, TooManyRowsError, at_rate

    try:
        t_ns, columns, notes = at_rate(series, rate_hz, gaps=gaps)
    except HoleError as error:
        raise InputError(source, "", str(error), MARK_REMEDY) from None
    except TooManyRowsError as error:
        raise InputError(source, "--rate", *error.args) from None
    return {name: Series(t_ns, column) for name, column in columns.items()}, notes


def _carriers(source: Path, signals: Path | None) -> dict[str, str]:
    """The CAN message of each signal of a log."""
    if signals is None or not is_can_log(source):
        return {}
    from eps_hil.bus.mapping import load_mapping

    mapped = load_mapping(signals).signals
    return {name: one.carrier for name, one in mapped.items() if one.carrier is not None}


def _told(series: Mapping[str, Series], suffix: str) -> tuple[str, ...]:
    """What becomes of bad samples; not of an estimate's, which ``valid`` explains."""
    bad = [
        name for name, one in series.items() if name not in ESTIMATES and np.isnan(one.value).any()
    ]
    if not bad:
        return ()
    fate = _FATE.get(suffix, "empty cells: read the table with --gaps mark")
    return (f"bad samples of {', '.join(bad)} are {fate}",)


def _log_to_log(
    source: Path,
    target: Path,
    channel: str | None,
    on_progress: Callable[[float], None] | None,
    say_written: Callable[[str], None],
    dbc: Sequence[Path] = (),
) -> tuple[str, ...]:
    notes: list[str] = []
    tagged = read_tagged_frames(source, channel=channel, notes=notes, on_progress=on_progress)
    first = next(tagged)  # before anything is written: a broken log raises here
    frames, more = write_log(target, chain([first], tagged), first[1].t_ns, source.name, dbc)
    say_written(f"{frames} frames" + ", as bus logging," * (target.suffix.lower() == ".mf4"))
    return (*notes, *more)


def write_log(
    target: Path,
    tagged: Iterable[tuple[str, Frame]],
    start_ns: int,
    source: str = "",
    dbc: Sequence[Path] = (),
) -> tuple[int, tuple[str, ...]]:
    """Write frames with their channels, in this order, as a CAN log; how many, and the notes.

    ``start_ns``: the first stamp. ``source``: the file that they are from. The notes say which bus
    has which number, where the format has no names.
    """
    suffix, channels, frames, lost = target.suffix.lower(), ChannelNumbers(), 0, 0
    with replacing(target) as temporary:
        if suffix == ".mf4":
            from eps_hil.recordings.mf4_bus import write_bus_mf4

            frames = write_bus_mf4(temporary, tagged, channels, dbc, source)
            return frames, channels.notes()
        if suffix == ".log":
            with temporary.open("w", encoding="ascii", newline="\n") as file:
                for name, frame in tagged:
                    file.write(candump_line(frame, channels.interface(name)))
                    frames += 1
            return frames, ()
        from eps_hil.bus.python_can import to_message

        writer = _log_writer(temporary, suffix, start_ns / _NS)
        try:
            for name, frame in tagged:
                # python-can's writers of numbered channels add the 1 again
                number = channels.number(name) - 1
                # ASC counts from the first frame, and knows no time before
                t_ns = max(frame.t_ns, start_ns) if suffix == ".asc" else frame.t_ns
                writer.on_message_received(to_message(replace(frame, t_ns=t_ns), number))
                lost += suffix == ".asc" and frame.error and bool(frame.can_id or frame.data)
                frames += 1
        finally:
            writer.stop()
    what = f"{lost} error frames are without their class and data, for which ASC has no place"
    return frames, (*channels.notes(), *((what,) if lost else ()))


def _log_writer(path: Path, suffix: str, start_s: float) -> Any:
    """python-can's writer of a log that begins at ``start_s``; its ``stop`` ends the file."""
    import can

    if suffix == ".blf":
        writer = can.BLFWriter(path)
        if start_s < _YEAR_1990_S:
            writer.start_timestamp = 0.0
        return writer
    return can.ASCWriter(path)
