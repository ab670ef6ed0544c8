"""Columns that a program holds -> canonical signals, by the rules that files are read by."""

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.errors import InputError
from eps_hil.recordings.recording import Recording
from eps_hil.recordings.table import (
    TIME_NS,
    VALID,
    Table,
    check_increasing,
    clocks_apart,
    shown,
    stamps_from_seconds,
    to_series,
    usable_columns,
)
from eps_hil.signals import TIME

Array = npt.NDArray[Any]


def from_arrays(
    columns: Any, name: str = "recording", *, gaps: str = "refuse", ignore_unknown: bool = False
) -> Recording:
    """A mapping of equally long arrays (n,), or a data frame, with ``time_s`` or ``time_ns``.

    Times increase: seconds, integer nanoseconds, or dates (without a zone: in UTC) and durations.
    NaN is an empty cell, as where another signal has the row's sample. ``gaps`` and
    ``ignore_unknown`` as for a file. :class:`InputError` names ``name`` and the column.
    """
    arrays, place = dict(_columns(columns, name)), Path(name)
    known, notes = usable_columns(place, list(arrays), "columns", ignore_unknown=ignore_unknown)
    clock = TIME_NS if TIME_NS in known else TIME
    length = len(arrays[clock])
    if not length:
        raise InputError(name, "", "has no rows", "a recording needs rows")
    for column in known:
        if len(arrays[column]) != length:
            problem = f"has {len(arrays[column])} values where {clock} has {length}"
            raise InputError(name, f"column {column}", problem, "give each row a value or NaN")
    numbers = {
        column: _numbers(name, column, arrays[column])
        for column in known
        if column not in (TIME, TIME_NS)
    }
    stamps = _stamps(name, clock, arrays[clock])
    if clock == TIME_NS and TIME in known:
        beside = arrays[TIME]
        if beside.dtype.kind in "mM":
            seconds = np.multiply(_stamps(name, TIME, beside), 1e-9, dtype=np.float64)
        else:
            seconds = _numbers(name, TIME, beside)
        notes += clocks_apart(seconds, stamps)
    table = Table(stamps, numbers, _row, notes)
    check_increasing(place, table.t_ns, _row, column=f"column {clock}")
    found, more = to_series(place, table, gaps=gaps)
    series = {column: one for column, one in found.items() if column != VALID}
    if not series:
        raise InputError(name, "", "no signal has a value", "give at least one")
    return Recording(name, series, more)


def _columns(columns: Any, name: str) -> Iterator[tuple[str, Array]]:
    """Names and values; a data frame of whatever library is a mapping that says its columns."""
    names = getattr(columns, "columns", None)
    if names is None and not isinstance(columns, Mapping):
        raise InputError(
            name, "", f"is of type {type(columns).__name__}",
            "give a mapping of arrays or a data frame, with time_s and canonical columns",
        )  # fmt: skip
    for column in columns if names is None else names:
        if not isinstance(column, str):
            raise InputError(name, "", f"has a column {column!r}", "name columns by words")
        values = _filled(columns[column])
        if values.ndim != 1:
            problem = f"has the shape {values.shape}"
            raise InputError(name, f"column {column}", problem, "give one value a row, (n,)")
        yield column, values


def _filled(values: Any) -> Array:
    """NaN (of times: NaT) where a value is masked, integers included; dates in UTC."""
    if getattr(getattr(values, "dtype", None), "tz", None) is not None:  # pandas
        return np.asarray(values, "datetime64[ns]")
    masked = np.ma.asanyarray(values)
    if masked.dtype.kind == "O" and all(isinstance(one, datetime) for one in masked.flat):
        return np.array([_utc(one) for one in masked.flat], "datetime64[ns]")
    if not np.ma.is_masked(masked):
        return np.asarray(masked)
    if masked.dtype.kind in "iub":
        masked = masked.astype(np.float64)
    missing = np.array("NaT", masked.dtype) if masked.dtype.kind in "mM" else np.nan
    return np.asarray(masked.filled(missing))


def _utc(instant: datetime) -> datetime:
    return instant if instant.tzinfo is None else instant.astimezone(UTC).replace(tzinfo=None)


def _numbers(name: str, column: str, values: Array) -> npt.NDArray[np.float64]:
    """Floats; infinite where the row holds something that is not a finite number."""
    if values.dtype.kind in "fiub":
        numbers = values.astype(np.float64)
        numbers[np.isinf(numbers)] = np.inf
        return numbers
    if values.dtype.kind != "O":
        problem = f"holds {values.dtype}, not numbers"
        raise InputError(name, f"column {column}", problem, "convert it to numbers")
    numbers = np.empty(len(values))
    for row, value in enumerate(values.tolist()):
        try:
            numbers[row] = np.nan if value is None else float(value)
        except (TypeError, ValueError):
            problem = f"holds {shown(value)}, not a number"
            raise InputError(name, f"{_row(row)}, column {column}", problem, "mend it") from None
    numbers[np.isinf(numbers)] = np.inf
    return numbers


def _stamps(name: str, column: str, values: Array) -> npt.NDArray[np.int64]:
    if values.dtype.kind in "mM":
        if np.isnat(values).any():
            place = f"{_row(int(np.argmax(np.isnat(values))))}, column {column}"
            raise InputError(name, place, "has no time", "remove the row")
        unit = values.dtype.kind + "8[ns]"
        return np.asarray(values.astype(unit).astype(np.int64))
    if column == TIME_NS and values.dtype.kind in "iu":
        return np.asarray(values.astype(np.int64))
    seconds = _numbers(name, column, values) * (1e-9 if column == TIME_NS else 1.0)
    return stamps_from_seconds(Path(name), seconds, _row, column=f"column {column}")


def _row(row: int) -> str:
    return f"row {row}"
