"""Measurement MF4 <-> signals, through asammdf (the ``mf4`` extra).

Channels carry canonical names; every channel keeps its own time base, so nothing here needs the
rule for empty cells, and a bad sample is one whose invalidation bit is set. MF4 files of raw CAN
frames ("bus logging") go through ``can_log`` and ``mf4_bus``.
"""

import contextlib
import hashlib
import logging
import sys
import threading
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.errors import InputError
from eps_hil.recordings.files import check_readable, needs_extra
from eps_hil.recordings.mf4_values import check_time_axis, signal_of
from eps_hil.recordings.table import (
    MARK_REMEDY,
    VALID,
    Flags,
    check_increasing,
    other_unit,
    stamps_from_seconds,
    usable_columns,
)
from eps_hil.series import Series
from eps_hil.signals import CANONICAL, PUBLISHED, TIME
from eps_hil.version import VERSION

_NS = 1_000_000_000
_EPOCH_NS = 10**17  # 1973: earlier stamps count from the start of a recording
_ABOUT = {VALID: "1 where the estimate beside it holds", "reason": "why it does not, bits"}


def has_bus_frames(path: Path) -> bool:
    """Whether the file is CAN bus logging: raw frames that need a DBC."""
    from eps_hil.recordings.mf4_columns import has_frames

    with opened_mf4(path, bus_map=False) as mdf:
        return any(has_frames(group) for group in mdf.groups)


def read_mf4(
    path: Path, *, gaps: str, ignore_unknown: bool
) -> tuple[dict[str, Series], tuple[str, ...]]:
    """Series of every canonical channel, in the order of CONTRACT 2, and notes."""
    with opened_mf4(path) as mdf:
        masters = set(mdf.masters_db.items())
        places = [
            (group, index, channel.name)
            for group, content in enumerate(mdf.groups)
            for index, channel in enumerate(content.channels)
            if (group, index) not in masters and channel.name != TIME
        ]
        names = [TIME, *(name for _, _, name in places)]
        columns, notes = usable_columns(path, names, "", ignore_unknown=ignore_unknown)
        start_ns = epoch_ns(mdf.header.start_time)
        series: dict[str, Series] = {}
        bad: dict[str, Flags] = {}
        for name, index in columns.items():
            if name == TIME:
                continue
            group, channel, _ = places[index - 1]
            check_time_axis(path, mdf, group, name)
            signal = signal_of(mdf, group, channel)
            notes += other_unit(name, signal.unit or "")
            if len(signal.samples):
                series[name], bad[name] = samples_of(path, name, signal, start_ns)
            else:
                notes += (f"channel {name} has no sample: left out",)
    for name, bad_samples in bad.items():
        flags = bad_samples & ~_said_invalid(series, name) if name in PUBLISHED else bad_samples
        if flags.any() and gaps == "refuse":
            where = f"{_place(int(np.argmax(flags)))}, channel {name}"
            raise InputError(path, where, "is NaN, infinite or marked invalid", MARK_REMEDY)
        if flags.any():
            notes += (f"channel {name}: {np.count_nonzero(flags)} bad samples marked",)
    order = [*CANONICAL, VALID]
    return dict(sorted(series.items(), key=lambda item: order.index(item[0]))), notes


def write_mf4(
    path: Path,
    series: Mapping[str, Series],
    *,
    source: str = "",
    carriers: Mapping[str, str] | None = None,
) -> None:
    """Write signals, each on its own stamps; a bad sample (NaN) gets its invalidation bit.

    ``source``: the file that they are from; ``carriers``: the CAN message of each, where there is
    one. A message's signals with the same stamps are a channel group of that name.
    """
    with needs_extra(path, "mf4"):
        from asammdf import MDF
    start_ns = epoch_of(
        min((int(one.t_ns[0]) for one in series.values() if len(one.t_ns)), default=0)
    )
    groups: dict[tuple[str, bytes], list[str]] = {}
    for name, one in series.items():
        carrier = (carriers or {}).get(name, "")
        stamps = hashlib.sha256(one.t_ns.tobytes()).digest()
        groups.setdefault((carrier, stamps), []).append(name)
    with quiet(), MDF(version="4.10") as mdf:
        mdf.header.abs_time = start_ns
        mdf.header.comment = about_file(source)
        for (carrier, _), names in groups.items():
            origin = _origin(carrier, source)
            mdf.append(
                [_channel(name, series[name], start_ns, origin) for name in names],
                acq_name=carrier or source or "eps_hil",
                acq_source=origin,
                comment=f"CAN message {carrier}" if carrier else about_file(source),
                common_timebase=True,
            )
        mdf.save(path, overwrite=True)


def about_file(source: str) -> str:
    """The comment of a file: what wrote it, from what."""
    return f"eps_hil {VERSION}" + (f", from {source}" if source else "")


def epoch_of(first_ns: int) -> int:
    """The instant from which a file's floats of seconds count, in ns since 1970."""
    return first_ns // _NS * _NS if first_ns > _EPOCH_NS else 0


def _origin(carrier: str, source: str) -> Any:
    from asammdf.blocks import v4_constants
    from asammdf.blocks.source_utils import Source

    if carrier:
        kind, bus = v4_constants.SOURCE_BUS, v4_constants.BUS_TYPE_CAN
        return Source(carrier, carrier, f"CAN message, from {source}", kind, bus)
    kind, bus = v4_constants.SOURCE_TOOL, v4_constants.BUS_TYPE_NONE
    return Source("eps_hil", source, about_file(source), kind, bus)


def _channel(name: str, one: Series, start_ns: int, origin: Any) -> Any:
    from asammdf import Signal

    known = CANONICAL.get(name)
    bad = np.isnan(one.value)
    return Signal(
        one.value.astype(np.int8) if name == VALID and not bad.any() else one.value,
        (one.t_ns - start_ns) / _NS,
        name=name,
        unit=known.unit if known else "",
        comment=known.description if known else _ABOUT.get(name, ""),
        source=origin,
        invalidation_bits=bad if bad.any() else None,
    )


@contextlib.contextmanager
def opened_mf4(path: Path, bus_map: bool = True) -> Iterator[Any]:
    """An open MDF; whatever asammdf raises on a broken file becomes :class:`InputError`.

    ``bus_map``: asammdf looks through all frames for their ids.
    """
    with needs_extra(path, "mf4"):
        import asammdf
    opened: Any = asammdf.MDF  # its annotations leave the option out
    check_readable(path)
    with quiet():
        try:
            with opened(path, process_bus_logging=bus_map) as mdf:
                yield mdf
        except InputError:
            raise
        except Exception as error:  # asammdf has no error base: struct, Key, zlib, its own
            _lay_to_rest(error)
            problem = f"is not readable as MF4 ({type(error).__name__})"
            raise InputError(path, "", problem, "record or export it again") from None


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep what asammdf logs and prints about odd files away from the user.

    What other threads print goes where it always does: recordings are read side by side.
    """
    me = threading.get_ident()
    with _LOCK:
        if not _WITHIN:
            _HUSHED.enter_context(_hushed())
        _WITHIN[me] += 1
    try:
        yield
    finally:
        with _LOCK:
            _WITHIN[me] -= 1
            if not _WITHIN[me]:
                del _WITHIN[me]
            if not _WITHIN:
                _HUSHED.close()


_LOCK, _HUSHED = threading.Lock(), contextlib.ExitStack()
_WITHIN: Counter[int] = Counter()
"""How often each thread is within :func:`quiet`."""


@contextlib.contextmanager
def _hushed() -> Iterator[None]:
    log = logging.getLogger("asammdf")
    before = log.level
    log.setLevel(logging.CRITICAL + 1)
    out: Any = _Hushed(sys.stdout)
    err: Any = _Hushed(sys.stderr)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            yield
    finally:
        log.setLevel(before)


class _Hushed:
    """A stream that drops what threads within :func:`quiet` write."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """How many characters were taken."""
        if threading.get_ident() in _WITHIN:
            return len(text)
        return int(self._stream.write(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _lay_to_rest(error: Exception) -> None:
    """Mark what asammdf had half built as closed, or its ``__del__`` writes to stderr."""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        unfinished: Any = frame.f_locals.get("self")
        if type(unfinished).__module__.startswith("asammdf") and hasattr(unfinished, "_closed"):
            unfinished._closed = True


def epoch_ns(start: datetime) -> int:
    """When a file says that it begins, in ns since 1970."""
    passed = start.astimezone(UTC) - datetime(1970, 1, 1, tzinfo=UTC)
    return ((passed.days * 86_400 + passed.seconds) * 1_000_000 + passed.microseconds) * 1000


def _place(row: int) -> str:
    return f"sample {row + 1}"


def _said_invalid(series: Mapping[str, Series], name: str) -> Flags:
    """Samples at whose stamp the file itself says that the estimate does not hold."""
    t_ns, valid = series[name].t_ns, series.get(VALID)
    if valid is None:
        return np.zeros(len(t_ns), dtype=bool)
    return np.isin(t_ns, valid.t_ns[valid.value == 0.0])


def samples_of(path: Path, name: str, signal: Any, start_ns: int) -> tuple[Series, Flags]:
    """The channel's samples, NaN where one is bad, and which are."""
    column = f"channel {name}"
    if signal.samples.dtype.kind not in "iufb" or signal.samples.ndim != 1:
        raise InputError(path, column, "does not hold plain numbers", "export it as numbers")
    t_ns = start_ns + stamps_from_seconds(
        path, signal.timestamps.astype(np.float64), _place, column=column
    )
    check_increasing(path, t_ns, _place, column=column)
    value = signal.samples.astype(np.float64)
    bad = ~np.isfinite(value)
    if signal.invalidation_bits is not None:
        bad |= np.asarray(signal.invalidation_bits, dtype=bool)
    value[bad] = np.nan
    return Series(t_ns, value), bad
