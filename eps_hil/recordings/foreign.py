"""Traces of somebody else's tool: any column names, units and separators, time steps that repeat.

Simulink, CarMaker and FMU tools export tables whose columns have names of their own, often with a
line of units under them, semicolons, decimal commas, and two rows at the instant of an event. A
recording (CONTRACT 3) is held to more; this reader takes what such a tool writes:

    time: {column: Time, scale: 1.0}          # scale: to seconds
    signals:
      motor_speed_rad_s: {column: n_rotor, scale: 0.104720, offset: 0.0}   # rpm to rad/s

Without a mapping the canonical names (CONTRACT 2) are looked for, and other columns left out.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, ConfigDict, Field, with_config
from pydantic_core import PydanticCustomError

from eps_hil import yaml_file
from eps_hil.errors import InputError
from eps_hil.recordings.arrow_numbers import numbers
from eps_hil.recordings.files import needs_extra, read_bytes
from eps_hil.recordings.read import is_can_log, read_recording
from eps_hil.recordings.recording import Recording
from eps_hil.recordings.table import Table, check_increasing, stamps_from_seconds, to_series
from eps_hil.series import Series
from eps_hil.signals import CANONICAL, TIME

Floats = npt.NDArray[np.float64]
Finite = Annotated[float, Field(allow_inf_nan=False)]
_STRICT = ConfigDict(extra="forbid")
_UNIT_LINES = 3
"""At most so many lines of units or comments stand between the names and the numbers."""


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise PydanticCustomError("mapping", "must not be zero")
    return value


def _canonical(name: str) -> str:
    if name not in CANONICAL:
        raise PydanticCustomError("mapping", "is no canonical signal (docs/reference-files.md)")
    return name


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Column:
    """Where one signal stands: canonical value = column · ``scale`` + ``offset``.

    ``sum`` names several columns in the place of one. With ``torque_constant_nm_per_a`` the result
    is a current (A), and the torque is the constant times it. With ``counts_per_turn`` the column
    counts an encoder's steps and begins anew after a turn: it becomes an unwrapped angle (rad),
    before ``scale`` and ``offset``.
    """

    column: str = ""
    scale: Annotated[Finite, AfterValidator(_not_zero)] = 1.0
    offset: Finite = 0.0
    sum: tuple[str, ...] = ()
    torque_constant_nm_per_a: Annotated[Finite, AfterValidator(_not_zero)] | None = None
    counts_per_turn: Annotated[float, Field(gt=1.0, allow_inf_nan=False)] | None = None

    def __post_init__(self) -> None:
        if bool(self.column) == bool(self.sum):
            raise PydanticCustomError("mapping", "needs a column, or a sum of columns")

    @property
    def columns(self) -> tuple[str, ...]:
        """The table's columns that it is made of."""
        return self.sum or (self.column,)

    def value(self, columns: Sequence[Floats]) -> Floats:
        """The signal (n,), of those columns."""
        found = np.sum(columns, axis=0)
        if self.counts_per_turn is not None:
            found, good = np.full(len(found), np.nan), np.isfinite(found)
            counts = np.sum(columns, axis=0)[good]
            turned = np.unwrap(counts, period=self.counts_per_turn)
            found[good] = turned * (2.0 * np.pi / self.counts_per_turn)
        found = found * self.scale + self.offset
        constant = self.torque_constant_nm_per_a
        return np.asarray(found if constant is None else found * constant)


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Columns:
    """The mapping file of a foreign table."""

    signals: Mapping[Annotated[str, AfterValidator(_canonical)], Column]
    time: Column = field(default_factory=lambda: Column(TIME))


def load_columns(path: Path) -> Columns:
    """Read a mapping of column names; :class:`InputError` names line and field."""
    return yaml_file.load(path, Columns)


def read_foreign(path: Path, columns: Columns | None = None) -> Recording:
    """One table (CSV, Parquet, MF4) of somebody's tool as canonical signals.

    ``InputError`` if a mapped column is missing or nothing canonical is found.
    """
    if path.suffix.lower() not in (".csv", ".txt", ".tsv", ".parquet"):
        if columns is None or is_can_log(path):
            return read_recording(path, gaps="mark", ignore_unknown=True)
        table = _mf4(path, columns)
    else:
        table = read_table(path)
    wanted = columns or Columns({name: Column(name) for name in CANONICAL if name in table})
    if not wanted.signals:
        raise InputError(
            path, "", "has no column with a canonical name", "give --simulation-signals"
        )
    time = _column(path, table, wanted.time)
    keep = _last_of_each(time)
    t_ns = np.rint(time[keep] * 1e9).astype(np.int64)
    series = {}
    for name, source in wanted.signals.items():
        value = _column(path, table, source)[keep]
        good = np.isfinite(value)
        if np.sum(good) > 1:
            series[name] = Series(t_ns[good], value[good])
    if not series:
        raise InputError(path, "", "no signal has a value", "export at least one")
    return Recording(path.name, series, _left_out(table, wanted))


def _left_out(table: Mapping[str, Floats], wanted: Columns) -> tuple[str, ...]:
    used = {name for one in (wanted.time, *wanted.signals.values()) for name in one.columns}
    left = [name for name in table if name not in used]
    return (f"columns left out: {', '.join(left[:8])}",) if left else ()


def maps_columns(path: Path) -> bool:
    """Whether a mapping (YAML) speaks of a table's columns, and not of a DBC's signals."""
    content = yaml_file.read(path)
    signals = content.get("signals") if isinstance(content, dict) else None
    entries = signals.values() if isinstance(signals, dict) else ()
    return any(isinstance(one, dict) and {"column", "sum"} & one.keys() for one in entries)


def read_mapped(
    path: Path, mapping: Path, *, gaps: str
) -> tuple[Mapping[str, Series], tuple[str, ...]]:
    """A recording's table (CSV, Parquet, MF4) by a mapping of its columns (``--signals``).

    As strict as with canonical names: time that goes back and holes are refused (holes marked,
    where ``gaps`` says so).
    """
    wanted = load_columns(mapping)
    suffix = path.suffix.lower()
    if suffix == ".mf4":
        table = _mf4(path, wanted)
    else:
        table = _parquet(path) if suffix == ".parquet" else _csv(path)

    def place(row: int) -> str:
        return f"row {row + 1}"

    t_ns = stamps_from_seconds(path, _column(path, table, wanted.time), place)
    check_increasing(path, t_ns, place)
    columns = {name: _column(path, table, one) for name, one in wanted.signals.items()}
    return to_series(path, Table(t_ns, columns, place, _left_out(table, wanted)), gaps=gaps)


def _last_of_each(time: Floats) -> npt.NDArray[np.bool_]:
    """Of rows at the same instant (an event) the last one; rows that go back are left out."""
    ahead = np.maximum.accumulate(np.where(np.isfinite(time), time, -np.inf))
    following = np.append(ahead[1:], np.inf)
    return np.isfinite(time) & (time >= ahead) & (following > ahead)


def _column(path: Path, table: Mapping[str, Floats], source: Column) -> Floats:
    for name in source.columns:
        if name not in table:
            known = ", ".join(list(table)[:8])
            raise InputError(path, f"column '{name}'", "is missing", f"there are: {known}")
    return source.value([table[name] for name in source.columns])


def read_table(path: Path) -> dict[str, Floats]:
    """All columns of a text table or Parquet file by their names, as that tool wrote them."""
    return _parquet(path) if path.suffix.lower() == ".parquet" else _csv(path)


def _csv(path: Path) -> dict[str, Floats]:
    text = read_bytes(path).decode("utf-8-sig", errors="replace")
    lines = text.splitlines()
    if not lines:
        raise InputError(path, "", "is empty", "export it again")
    sign = max(";\t,", key=lines[0].count)
    names = [name.strip() for name in next(csv.reader([lines[0]], delimiter=sign))]
    first = next(
        (k for k in range(1, min(len(lines), _UNIT_LINES + 2)) if _numeric(lines[k], sign)), None
    )
    if first is None:
        raise InputError(path, "line 2", "no line of numbers follows the names", "export it again")
    body = lines[first:]
    if sign != ",":
        body = [line.replace(",", ".") for line in body]
    try:
        cells = np.genfromtxt(body, delimiter=sign, ndmin=2, invalid_raise=True)
    except ValueError as error:
        problem = str(error).splitlines()[0]
        raise InputError(path, "", f"is no table: {problem}", "export it again") from None
    if cells.shape[1] < len(names):
        raise InputError(path, "line 1", "names more columns than there are", "export it again")
    return {name: np.ascontiguousarray(cells[:, k]) for k, name in enumerate(names) if name}


def _numeric(line: str, sign: str) -> bool:
    cells = [cell.strip() for cell in line.split(sign) if cell.strip()]
    return bool(cells) and all(
        _number(cell if sign == "," else cell.replace(",", ".")) for cell in cells
    )


def _number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _parquet(path: Path) -> dict[str, Floats]:
    with needs_extra(path, "parquet"):
        import pyarrow
        import pyarrow.parquet
    try:
        table = pyarrow.parquet.read_table(path)
    except (pyarrow.ArrowException, OSError) as error:
        problem = f"is not readable as Parquet: {str(error).splitlines()[0]}"
        raise InputError(path, "", problem, "export it again") from None
    found = {}
    for name in table.column_names:
        kind = table.column(name).type
        if pyarrow.types.is_floating(kind) or pyarrow.types.is_integer(kind):
            found[name] = numbers(table.column(name).cast(pyarrow.float64(), safe=False))
    return found


def _mf4(path: Path, columns: Columns) -> dict[str, Floats]:
    """The mapped channels on the time of the first one."""
    with needs_extra(path, "mf4"):
        import asammdf
    names = list(dict.fromkeys(n for one in columns.signals.values() for n in one.columns))
    with asammdf.MDF(path) as mdf:
        missing = [name for name in names if name not in mdf]
        if missing:
            raise InputError(path, f"channel '{missing[0]}'", "is missing", "mend the mapping")
        signals = [mdf.get(name) for name in names]
    time = max((np.asarray(one.timestamps, dtype=np.float64) for one in signals), key=len)
    found = {
        name: np.interp(time, one.timestamps, np.asarray(one.samples, dtype=np.float64))
        for name, one in zip(names, signals, strict=True)
    }
    return {**found, columns.time.column: time}
