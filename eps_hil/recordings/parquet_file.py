"""Parquet <-> table columns, through pyarrow (the ``parquet`` extra)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.errors import InputError
from eps_hil.recordings.arrow_numbers import numbers
from eps_hil.recordings.files import check_readable, needs_extra
from eps_hil.recordings.table import (
    TIME_NS,
    Floats,
    NamedColumns,
    Stamps,
    Table,
    check_once,
    clocks_apart,
    other_unit,
    stamps_from_seconds,
    usable_columns,
)
from eps_hil.signals import CANONICAL, TIME
from eps_hil.version import VERSION


def read_parquet(path: Path, *, ignore_unknown: bool = False) -> Table:
    """Read one Parquet file; a null is an empty cell, a NaN a bad value."""
    notes: tuple[str, ...] = ()

    def choose(schema: Any) -> list[str]:
        nonlocal notes
        names = schema.names
        columns, notes = usable_columns(path, names, "schema", ignore_unknown=ignore_unknown)
        for name, place in columns.items():
            said = (schema.field(place).metadata or {}).get(b"unit", b"")
            notes += other_unit(name, said.decode(errors="replace"))
        return list(columns)

    content = _content(path, choose)
    columns = content.column_names
    signals = {
        name: _floats(path, name, content.column(name))
        for name in columns
        if name not in (TIME, TIME_NS)
    }
    stamps = _stamps(path, content)
    if TIME_NS in columns and TIME in columns:
        notes += clocks_apart(_clock(path, TIME, content.column(TIME)), stamps)
    del content  # an hour's table is 200 MB, and all of it is copied by now
    _release()
    return Table(stamps, signals, _row, notes)


def read_named(path: Path, wanted: Sequence[str] | None) -> NamedColumns:
    """The ``wanted`` columns that it has, the time first (None: all that hold numbers)."""
    names: tuple[str, ...] = ()

    def choose(schema: Any) -> list[str]:
        nonlocal names
        names = tuple(schema.names)
        check_once(path, "schema", names, wanted or names)
        return [name for name in names if wanted is None or name in wanted]

    content = _content(path, choose)
    found, instants = {}, False
    for name in content.column_names:
        column = content.column(name)
        if wanted and name == wanted[0] and (seconds := _seconds(column)) is not None:
            found[name], instants = seconds, True
        elif wanted is not None or _holds_numbers(column.type):
            found[name] = _floats(path, name, column)
    del content
    _release()
    return NamedColumns(names, found, _row, instants)


def _content(path: Path, choose: Callable[[Any], list[str]]) -> Any:
    """A file's chosen columns (of pyarrow)."""
    with needs_extra(path, "parquet"):
        import pyarrow
        import pyarrow.parquet
    check_readable(path)
    try:
        file = pyarrow.parquet.ParquetFile(path, memory_map=False)
        content = file.read(columns=choose(file.schema_arrow))
    except InputError:
        raise
    except (pyarrow.ArrowException, OSError, ValueError, MemoryError) as error:
        problem = f"is not readable as Parquet: {str(error).splitlines()[0] if str(error) else ''}"
        raise InputError(path, "", problem, "record or export it again") from None
    if not file.metadata.num_rows:
        raise InputError(path, "", "has no rows", "a recording needs rows")
    return content


def _release() -> None:
    import pyarrow

    pyarrow.default_memory_pool().release_unused()


def _seconds(column: Any) -> Floats | None:
    """Dates (since 1970, UTC) or durations in seconds; None where it holds neither."""
    import pyarrow

    kind = column.type
    if not (pyarrow.types.is_timestamp(kind) or pyarrow.types.is_duration(kind)):
        return None
    whole = column.cast(pyarrow.int64()).cast(pyarrow.float64(), safe=False)
    return numbers(whole) * {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]


def _holds_numbers(kind: Any) -> bool:
    import pyarrow

    return any(
        is_kind(kind)
        for is_kind in (
            pyarrow.types.is_boolean,
            pyarrow.types.is_integer,
            pyarrow.types.is_floating,
            pyarrow.types.is_decimal,
        )
    )


def write_parquet(path: Path, parts: Iterable[Mapping[str, npt.NDArray[Any]]]) -> None:
    """Write equally long columns, a row group of each part; NaN becomes null.

    The schema holds each column's unit.
    """
    with needs_extra(path, "parquet"):
        import pyarrow
        import pyarrow.parquet
    writer = None
    try:
        for columns in parts:
            arrays = {
                name: pyarrow.array(column, from_pandas=True)  # from_pandas: NaN is null
                for name, column in columns.items()
            }
            if writer is None:
                fields = [
                    pyarrow.field(name, array.type, metadata=_about(name))
                    for name, array in arrays.items()
                ]
                schema = pyarrow.schema(fields, metadata={"written_by": f"eps_hil {VERSION}"})
                writer = pyarrow.parquet.ParquetWriter(path, schema)
            writer.write_table(pyarrow.table(arrays, schema=writer.schema))
    finally:
        if writer is not None:
            writer.close()


def _about(name: str) -> dict[str, str]:
    """Unit and description, as the metadata of a column."""
    if name in (TIME, TIME_NS):
        return {"unit": "s" if name == TIME else "ns", "description": "sample time"}
    known = CANONICAL.get(name)
    return {"unit": known.unit, "description": known.description} if known else {}


def _row(row: int) -> str:
    return f"row {row + 1}"


def _floats(path: Path, name: str, column: Any) -> Floats:
    import pyarrow

    kind = column.type
    if pyarrow.types.is_boolean(kind):
        column = column.cast(pyarrow.int8())
    elif not _holds_numbers(kind):
        place = f"column {name}"
        raise InputError(path, place, f"holds {kind}, not numbers", "export it as numbers")
    values = numbers(column.cast(pyarrow.float64(), safe=False))
    bad = ~np.isfinite(values)
    if bad.any():
        values[bad & (numbers(column.is_valid().cast(pyarrow.int8())) != 0)] = np.inf
    return values


def _clock(path: Path, name: str, column: Any) -> Floats:
    seconds = _seconds(column)
    if seconds is None:
        return _floats(path, name, column)
    return seconds * (1e9 if name == TIME_NS else 1.0)


def _stamps(path: Path, content: Any) -> Stamps:
    import pyarrow

    name = TIME_NS if TIME_NS in content.column_names else TIME
    column = content.column(name)
    if name == TIME_NS and pyarrow.types.is_integer(column.type) and not column.null_count:
        return numbers(column).astype(np.int64, copy=False)
    seconds = _clock(path, name, column) * (1e-9 if name == TIME_NS else 1.0)
    return stamps_from_seconds(path, seconds, _row, column=f"column {name}")
