"""Measurement MF4 <-> signals, through asammdf (the ``mf4`` extra).

Channels carry canonical names; every channel keeps its own time base, so nothing here needs the
rule for empty cells. MF4 files of raw CAN frames ("bus logging") go through ``can_log``.
"""

import contextlib
import io
import logging
import traceback
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.errors import InputError
from eps_hil.recordings.files import check_readable, needs_extra
from eps_hil.recordings.table import (
    MARK_REMEDY,
    VALID,
    Floats,
    Stamps,
    check_increasing,
    stamps_from_seconds,
    usable_columns,
)
from eps_hil.series import Series
from eps_hil.signals import CANONICAL, TIME

_NS = 1_000_000_000
_EPOCH_NS = 10**17  # 1973: earlier stamps count from the start of a recording


def has_bus_frames(path: Path) -> bool:
    """Whether the file is CAN bus logging: raw frames that need a DBC."""
    with _opened(path) as mdf:
        return bool(mdf.bus_logging_map.get("CAN"))


def read_mf4(
    path: Path, *, gaps: str, ignore_unknown: bool
) -> tuple[dict[str, Series], tuple[str, ...]]:
    """Series of every canonical channel, in the order of CONTRACT 2, and notes."""
    with _opened(path) as mdf:
        masters = set(mdf.masters_db.items())
        places = [
            (group, index, channel.name)
            for group, content in enumerate(mdf.groups)
            for index, channel in enumerate(content.channels)
            if (group, index) not in masters and channel.name != TIME
        ]
        names = [TIME, *(name for _, _, name in places)]
        columns, notes = usable_columns(path, names, "", ignore_unknown=ignore_unknown)
        start_ns = _epoch_ns(mdf.header.start_time)
        series: dict[str, Series] = {}
        for name, index in columns.items():
            if name == TIME:
                continue
            group, channel, _ = places[index - 1]
            signal = mdf.get(group=group, index=channel, ignore_invalidation_bits=True)
            if len(signal.samples):
                series[name], marked = _series(path, name, signal, start_ns, gaps)
                notes += (f"channel {name}: {marked} bad samples marked",) if marked else ()
            else:
                notes += (f"channel {name} has no sample: left out",)
    order = [*CANONICAL, VALID]
    return dict(sorted(series.items(), key=lambda item: order.index(item[0]))), notes


def write_mf4(path: Path, t_ns: Stamps, columns: Mapping[str, Floats]) -> None:
    """Write columns over ``t_ns`` (n,); an empty cell (NaN) is a sample less.

    Columns with the same samples share a channel group.
    """
    with needs_extra(path, "mf4"):
        from asammdf import MDF, Signal
    start_s = int(t_ns[0]) // _NS if len(t_ns) and t_ns[0] > _EPOCH_NS else 0
    relative_s = (t_ns - start_s * _NS) / _NS
    groups: dict[bytes, list[Any]] = {}
    for name, column in columns.items():
        there = ~np.isnan(column)
        samples = column[there].astype(np.int8) if name == VALID else column[there]
        unit = CANONICAL[name].unit if name in CANONICAL else ""
        signal = Signal(samples, relative_s[there], name=name, unit=unit)
        groups.setdefault(there.tobytes(), []).append(signal)
    with _quiet(), MDF(version="4.10") as mdf:
        mdf.header.abs_time = start_s * _NS
        for signals in groups.values():
            mdf.append(signals, common_timebase=True)
        mdf.save(path, overwrite=True)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """An open MDF; whatever asammdf raises on a broken file becomes :class:`InputError`."""
    with needs_extra(path, "mf4"):
        from asammdf import MDF
    check_readable(path)
    with _quiet():
        try:
            with MDF(path) as mdf:
                yield mdf
        except InputError:
            raise
        except Exception as error:  # asammdf has no error base: struct, Key, zlib, its own
            _lay_to_rest(error)
            problem = f"is not readable as MF4 ({type(error).__name__})"
            raise InputError(path, "", problem, "record or export it again") from None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep what asammdf logs and prints about odd files away from the user."""
    log = logging.getLogger("asammdf")
    before = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            yield
    finally:
        log.setLevel(before)


def _lay_to_rest(error: Exception) -> None:
    """Mark what asammdf had half built as closed, or its ``__del__`` writes to stderr."""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        unfinished: Any = frame.f_locals.get("self")
        if type(unfinished).__module__.startswith("asammdf") and hasattr(unfinished, "_closed"):
            unfinished._closed = True


def _epoch_ns(start: datetime) -> int:
    passed = start.astimezone(UTC) - datetime(1970, 1, 1, tzinfo=UTC)
    return ((passed.days * 86_400 + passed.seconds) * 1_000_000 + passed.microseconds) * 1000


def _series(path: Path, name: str, signal: Any, start_ns: int, gaps: str) -> tuple[Series, int]:
    def place(row: int) -> str:
        return f"sample {row + 1}"

    column = f"channel {name}"
    if signal.samples.dtype.kind not in "iufb" or signal.samples.ndim != 1:
        raise InputError(path, column, "does not hold plain numbers", "export it as numbers")
    t_ns = start_ns + stamps_from_seconds(
        path, signal.timestamps.astype(np.float64), place, column=column
    )
    check_increasing(path, t_ns, place, column=column)
    value = signal.samples.astype(np.float64)
    bad = ~np.isfinite(value)
    if signal.invalidation_bits is not None:
        bad |= np.asarray(signal.invalidation_bits, dtype=bool)
    if bad.any() and gaps == "refuse":
        where = f"{place(int(np.argmax(bad)))}, {column}"
        raise InputError(path, where, "is NaN, infinite or marked invalid", MARK_REMEDY)
    value[bad] = np.nan
    return Series(t_ns, value), int(np.count_nonzero(bad))
