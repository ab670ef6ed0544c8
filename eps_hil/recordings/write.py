"""Columns -> CSV, Parquet or MF4; signals -> these or MCAP.

Whole or not at all, and never a NaN that looks like a number.
"""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from eps_hil.errors import InputError
from eps_hil.growing import blocks
from eps_hil.recordings.files import replacing
from eps_hil.recordings.table import EPOCH_S, TIME_NS, VALID, Stamps, from_series, seconds_to_ns
from eps_hil.series import Series
from eps_hil.signals import TIME

TABLE_SUFFIXES = (".csv", ".parquet", ".mf4")
SERIES_SUFFIXES = (*TABLE_SUFFIXES, ".mcap")
_ROWS = 50_000
_AHEAD = 3
"""Pieces of so many rows for each core whose text may wait for a slow disk, or be in the making."""
_WORTH_ARROW = 20_000
"""Rows from which it is worth while to load pyarrow."""
_DIGITS = 19
_NS = 1_000_000_000
_TEN_DIGITS, _LATEST = 10**9 * _NS, 2**32 * _NS
"""Of Unix time, in ns: September 2001, from which on seconds have ten digits, to February 2106."""

Columns = Mapping[str, npt.NDArray[Any]]
Part = tuple[Stamps, dict[str, npt.NDArray[Any]]]
"""Some rows: their stamps (ns), and their columns."""


def check_writable_suffix(path: Path) -> None:
    """Refuse an output name whose suffix is no table format (before long work is done)."""
    if path.suffix.lower() not in TABLE_SUFFIXES:
        known = ", ".join(TABLE_SUFFIXES)
        problem = f"suffix '{path.suffix}' is no table format"
        raise InputError(path, "", problem, f"name it with one of {known}")


def write_series(
    path: str | Path,
    series: Mapping[str, Series],
    *,
    source: str = "",
    carriers: Mapping[str, str] | None = None,
) -> int:
    """Write signals, each on its own stamps; the format is the suffix. The rows, or stamps.

    Tables have an empty cell where a signal has no sample; MF4 and MCAP keep each one's own, and
    say that they are from ``source`` and from which CAN message (``carriers``).
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SERIES_SUFFIXES:
        problem = f"suffix '{path.suffix}' cannot be written"
        raise InputError(path, "", problem, f"use {', '.join(SERIES_SUFFIXES)}")
    if suffix in (".mf4", ".mcap"):
        with replacing(path) as temporary:
            if suffix == ".mf4":
                from eps_hil.recordings.mf4_file import write_mf4

                write_mf4(temporary, series, source=source, carriers=carriers)
            else:
                from eps_hil.recordings.mcap_file import write_mcap

                write_mcap(temporary, series, source=source, carriers=carriers)
        return len(np.unique(np.concatenate([one.t_ns for one in series.values()])))
    t_ns, columns = from_series(series)
    write_table(path, columns, t_ns=t_ns)
    return len(t_ns)


def write_table(path: str | Path, columns: Columns, *, t_ns: Stamps | None = None) -> None:
    """Write equally long columns; the format is the suffix (.csv, .parquet, .mf4).

    ``columns``: arrays of shape (n,), canonical names, ``time_s`` among them unless ``t_ns``
    (int64 ns) gives the time exactly. Floats round-trip bit for bit (but float epoch times are
    taken to the microsecond, which is what they resolve); ``valid``, booleans and
    integers are written as integers; NaN is written as an empty cell (MF4: no sample). Where
    floats of seconds cannot hold ``t_ns``, Parquet also gets an int64 column ``time_ns``.
    Raises :class:`InputError` for a wrong suffix or folder, :class:`EpsHilError` for a full disk.
    """
    path = Path(path)
    check_writable_suffix(path)
    plain = {name: _plain(name, np.asarray(column)) for name, column in columns.items()}
    timed = t_ns is not None
    if t_ns is None:
        t_ns = seconds_to_ns(np.asarray(plain[TIME], dtype=np.float64))
    if {len(column) for column in plain.values()} - {len(t_ns)}:
        raise ValueError("columns differ in length")

    def parts() -> Iterator[Part]:
        for at in blocks(len(t_ns)) if len(t_ns) else (slice(0, 0),):
            part = {name: column[at] for name, column in plain.items()}
            yield t_ns[at], {TIME: t_ns[at] / _NS, **part} if timed else part

    with replacing(path) as temporary:
        if path.suffix.lower() == ".csv":
            exact = all(np.abs(part[TIME]).max(initial=0.0) < EPOCH_S for _, part in parts())
            _write_csv(temporary, parts(), exact=exact, many=len(t_ns) >= _WORTH_ARROW)
        elif path.suffix.lower() == ".parquet":
            from eps_hil.recordings.parquet_file import write_parquet

            exact = all(np.array_equal(seconds_to_ns(part[TIME]), at) for at, part in parts())
            write_parquet(
                temporary, (part if exact else {TIME_NS: at, **part} for at, part in parts())
            )
        else:
            from eps_hil.recordings.mf4_file import write_mf4

            write_mf4(temporary, _filled(t_ns, plain))


def _filled(t_ns: Stamps, columns: Columns) -> dict[str, Series]:
    """Every column's own samples: where its cell is not empty."""
    series = {}
    for name, column in columns.items():
        if name != TIME:
            there = ~np.isnan(column)
            series[name] = Series(t_ns[there], column[there])
    return series


def _plain(name: str, column: npt.NDArray[Any]) -> npt.NDArray[Any]:
    if column.dtype.kind == "b" or (name == VALID and not np.isnan(column).any()):
        return column.astype(np.int8)
    return column if column.dtype.kind in "iu" else column.astype(np.float64, copy=False)


def _write_csv(path: Path, parts: Iterable[Part], *, exact: bool, many: bool) -> None:
    """``exact``: floats hold the time; ``many``: it is worth while to load pyarrow."""
    by_arrow = many and find_spec("pyarrow") is not None
    with path.open("wb") as raw:
        header = True
        for t_ns, columns in parts:
            if header:
                raw.write((",".join(columns) + "\n").encode())
                header = False
            if by_arrow:
                _write_by_arrow(raw, columns, None if exact else t_ns)
                continue
            for start in range(0, len(t_ns), _ROWS):
                at = slice(start, start + _ROWS)
                texts = [
                    _seconds(t_ns[at]) if name == TIME and not exact else _texts(column[at])
                    for name, column in columns.items()
                ]
                _write_rows(raw, texts)


def _write_by_arrow(file: IO[bytes], columns: Columns, t_ns: Stamps | None) -> None:
    """The same numbers, written shortest; ``t_ns`` where floats do not hold the time.

    On all cores: pyarrow writes a table on one.
    """
    import pyarrow
    import pyarrow.csv

    options = pyarrow.csv.WriteOptions(include_header=False, quoting_style="none")

    def text(rows: slice) -> Any:
        arrays = {
            name: pyarrow.array(column[rows], from_pandas=True)
            for name, column in columns.items()
            if name != TIME or t_ns is None
        }
        if t_ns is not None:
            arrays[TIME] = _decimals(t_ns[rows])
        out = pyarrow.BufferOutputStream()
        pyarrow.csv.write_csv(pyarrow.table({name: arrays[name] for name in columns}), out, options)
        return out.getvalue()

    starts = range(0, len(columns[TIME]), _ROWS)
    for part in _side_by_side(text, (slice(start, start + _ROWS) for start in starts)):
        file.write(part)


def _side_by_side(work: Callable[[slice], Any], pieces: Iterable[slice]) -> Iterator[Any]:
    """``work`` of every piece, on all cores and in order, but no more ahead than ``_AHEAD``."""
    from concurrent.futures import Future, ThreadPoolExecutor

    cores = os.cpu_count() or 1
    begun: deque[Future[Any]] = deque()
    with ThreadPoolExecutor(cores) as pool:
        for piece in pieces:
            if len(begun) == _AHEAD * cores:
                yield begun.popleft().result()
            begun.append(pool.submit(work, piece))
        while begun:
            yield begun.popleft().result()


def _decimals(t_ns: Stamps) -> Any:
    """Nanoseconds as seconds with nine places, for pyarrow to write."""
    import pyarrow

    if len(t_ns) and t_ns.min() >= _TEN_DIGITS and t_ns.max() < _LATEST:
        text = _ten_and_nine(t_ns)
        ends = np.arange(0, text.size + 1, text.shape[1], dtype=np.int32)
        return pyarrow.StringArray.from_buffers(
            len(t_ns), pyarrow.py_buffer(ends), pyarrow.py_buffer(text)
        )
    whole = pyarrow.array(t_ns).cast(pyarrow.decimal128(_DIGITS, 0))
    places = pyarrow.decimal128(_DIGITS, 9)
    return pyarrow.Array.from_buffers(places, len(whole), whole.buffers())


def _ten_and_nine(t_ns: Stamps) -> npt.NDArray[np.uint8]:
    """Seconds of ten digits, a point and nine places: their characters, (n, 20).

    Four digits at once, out of a list of all there are: pyarrow takes as long for a decimal number
    as for a float.
    """
    text = np.empty((len(t_ns), 20), np.uint8)
    seconds = t_ns // _NS
    places = t_ns - seconds * _NS
    text[:, 10] = ord(".")
    text[:, 11] = ord("0") + _fours(places.astype(np.uint32), text, (16, 12))
    first = _fours(seconds.astype(np.uint32), text, (6, 2))
    text[:, 0], text[:, 1] = ord("0") + first // 10, ord("0") + first % 10
    return text


def _fours(
    numbers: npt.NDArray[np.uint32], text: npt.NDArray[np.uint8], places: Iterable[int]
) -> npt.NDArray[np.uint32]:
    """Write the last digits of numbers, (n,), from each place on four; the digits before them."""
    for place in places:
        before = numbers // 10_000
        four = np.ndarray(len(text), np.uint32, text, place, text.strides[:1])
        four[:] = _characters()[numbers - 10_000 * before]
        numbers = before
    return numbers


@cache
def _characters() -> npt.NDArray[np.uint32]:
    """The characters of 0000 to 9999, each four as one number."""
    return np.frombuffer(b"".join(b"%04d" % number for number in range(10_000)), np.uint32)


def _write_rows(file: IO[bytes], texts: list[Iterable[str]]) -> None:
    file.writelines((",".join(row) + "\n").encode() for row in zip(*texts, strict=True))


def _texts(column: npt.NDArray[Any]) -> Iterable[str]:
    texts = map(repr, column.tolist())
    if column.dtype.kind == "f" and np.isnan(column).any():
        return ("" if text == "nan" else text for text in texts)
    return texts


def _seconds(t_ns: Stamps) -> Iterable[str]:
    for stamp in t_ns.tolist():
        whole, rest = divmod(stamp, _NS)
        if whole < 0 and rest:
            whole, rest = whole + 1, _NS - rest
            yield f"-{abs(whole)}.{rest:09d}"
        else:
            yield f"{whole}.{rest:09d}"
