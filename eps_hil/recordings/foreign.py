"""Traces of somebody else's tool: any column names, units and separators, time steps that repeat.

Simulink, CarMaker and FMU tools export tables whose columns have names of their own, often with a
line of units under them, semicolons, decimal commas, and two rows at the instant of an event. A
recording (CONTRACT 3) is held to more; this reader takes what such a tool writes:

    time: {column: Time, scale: 1.0}          # scale: to seconds
    signals:
      motor_speed_rad_s: {column: n_rotor, scale: 0.104720, offset: 0.0}   # rpm to rad/s

Without a mapping the canonical names (CONTRACT 2) are looked for, and other columns left out; an
entry without ``column`` means the column of that canonical name.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, with_config
from pydantic_core import PydanticCustomError

from eps_hil import yaml_file
from eps_hil.bus.mapping import load_mapping
from eps_hil.errors import InputError
from eps_hil.recordings.common_rate import linear, longest_step_ns
from eps_hil.recordings.read import is_can_log, read_recording
from eps_hil.recordings.recording import Recording
from eps_hil.recordings.table import (
    MARK_REMEDY,
    TIME_NS,
    NamedColumns,
    Table,
    check_increasing,
    shown,
    stamps_from_seconds,
    to_series,
)
from eps_hil.series import Series
from eps_hil.signals import CANONICAL, TIME

Floats = npt.NDArray[np.float64]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1)]
Notes = tuple[str, ...]
_STRICT = ConfigDict(extra="forbid")
_SHOWN = 8
_OF_A_BUS = {"message", "signal", "derive_from", "window_s", "supply_power"}
"""Fields of a DBC's mapping that a table's has not."""
_CURRENT, _COUNTED = ("motor_torque_nm",), ("motor_angle_rad", "steering_wheel_angle_rad")
_LARGEST_STEP = 0.4
"""Of a turn, between two samples: with noise on top of half of one, counts are ambiguous."""


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise PydanticCustomError("mapping", "must not be zero")
    return value


def _canonical(name: str) -> str:
    if name not in CANONICAL:
        raise PydanticCustomError("mapping", "is no canonical signal (docs/reference-files.md)")
    return name


def _fields(entry: Any) -> Any:
    if not isinstance(entry, dict | Column):
        raise PydanticCustomError("mapping", "needs fields, as in {column: NAME, scale: 1.0}")
    return entry


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Column:
    """Where one signal stands: canonical value = column · ``scale`` + ``offset``.

    ``sum`` names several columns in the place of one. With ``torque_constant_nm_per_a`` the result
    is a current (A), and the torque is the constant times it. With ``counts_per_turn`` the column
    counts an encoder's steps and begins anew after a turn: it becomes an unwrapped angle (rad),
    before ``scale`` and ``offset``.
    """

    column: Name = ""
    scale: Annotated[Finite, AfterValidator(_not_zero)] = 1.0
    offset: Finite = 0.0
    sum: Annotated[tuple[Name, ...], Field(min_length=1)] = ()
    torque_constant_nm_per_a: Annotated[Finite, AfterValidator(_not_zero)] | None = None
    counts_per_turn: Annotated[float, Field(gt=1.0, allow_inf_nan=False)] | None = None

    def __post_init__(self) -> None:
        if self.column and self.sum:
            raise PydanticCustomError("mapping", "takes a column or a sum of columns, not both")

    @property
    def columns(self) -> tuple[str, ...]:
        """The table's columns that it is made of."""
        return self.sum or (self.column,)

    def of(self, name: str) -> "Column":
        """The same, of the column of that name where it names none."""
        return self if self.column or self.sum else replace(self, column=name)

    def value(self, columns: Sequence[Floats]) -> Floats:
        """The signal (n,), of those columns; infinite where one of them is."""
        bad = np.logical_or.reduce([np.isinf(one) for one in columns])
        found = np.sum([np.where(bad, np.nan, one) for one in columns], axis=0)
        if self.counts_per_turn is not None:
            good = np.isfinite(found)
            turned = np.unwrap(found[good], period=self.counts_per_turn)
            found[good] = turned * (2.0 * np.pi / self.counts_per_turn)
        found = found * self.scale + self.offset
        constant = self.torque_constant_nm_per_a
        found = found if constant is None else found * constant
        return np.where(bad, np.inf, found)


Entry = Annotated[Column, BeforeValidator(_fields)]


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Columns:
    """The mapping file of a foreign table."""

    signals: Annotated[
        Mapping[Annotated[str, AfterValidator(_canonical)], Entry], Field(min_length=1)
    ]
    time: Entry = field(default_factory=Column)

    def __post_init__(self) -> None:
        named = {name: one.of(name) for name, one in self.signals.items()}
        object.__setattr__(self, "signals", named)
        object.__setattr__(self, "time", self.time.of(TIME))

    @property
    def columns(self) -> list[str]:
        """All columns that it names, the time first."""
        every = (self.time, *self.signals.values())
        return list(dict.fromkeys(name for one in every for name in one.columns))


def load_columns(path: Path) -> Columns:
    """Read a mapping of column names; :class:`InputError` names line and field."""
    found = yaml_file.load(path, Columns)
    for name, one in (("time", found.time), *found.signals.items()):
        place = name if name == "time" else f"signals.{name}"
        for given, field_name, owners in (
            (one.torque_constant_nm_per_a, "torque_constant_nm_per_a", _CURRENT),
            (one.counts_per_turn, "counts_per_turn", _COUNTED),
        ):
            if given is not None and name not in owners:
                problem = f"{field_name} belongs to {' or '.join(owners)}"
                raise InputError(path, place, problem, "correct the entry")
    return found


def read_foreign(path: Path, columns: Columns | None = None) -> Recording:
    """One table (CSV, Parquet, MF4) of somebody's tool as canonical signals.

    ``InputError`` if a mapped column is missing or nothing canonical is found.
    """
    if path.suffix.lower() not in (".csv", ".txt", ".tsv", ".parquet"):
        if columns is None or is_can_log(path):
            return read_recording(path, gaps="mark", ignore_unknown=True)
        found, notes = _mf4(path, columns, gaps="mark", events=True)
        return Recording(path.name, found, notes)
    table = _named(path, [TIME, *CANONICAL] if columns is None else columns.columns)
    wanted = columns
    if wanted is None:
        there = {name: Column() for name in CANONICAL if name in table.columns}
        if not there:
            raise InputError(
                path, "", "has no column with a canonical name", "give --simulation-signals"
            )
        wanted = Columns(there)
    time = _seconds(path, table, wanted.time)
    keep, notes = _last_of_each(time)
    t_ns = np.rint(time[keep] * 1e9).astype(np.int64)
    series = {}
    for name, source in wanted.signals.items():
        value = _value(path, table, source)[keep]
        good = np.isfinite(value)
        if bad := int(np.count_nonzero(np.isinf(value))):
            notes += (f"{name}: {bad} rows are no finite number: left out",)
        if np.sum(good) > 1:
            series[name] = Series(t_ns[good], value[good])
        else:
            notes += (f"{name} has no value: left out",)
    if not series:
        raise InputError(path, "", "no signal has a value", "export at least one")
    return Recording(path.name, series, (*_left_out(table.names, wanted), *notes))


def maps_columns(path: Path) -> bool:
    """Whether a mapping (YAML) speaks of a table's columns, and not of a DBC's signals.

    :class:`InputError` for one of a DBC that is wrong.
    """
    content = yaml_file.read(path)
    signals = content.get("signals") if isinstance(content, dict) else None
    entries = signals.values() if isinstance(signals, dict) else ()
    if not any(isinstance(one, dict) and one.keys() & _OF_A_BUS for one in entries):
        return True
    if any(isinstance(one, dict) and {"column", "sum"} & one.keys() for one in entries):
        return True  # where it is told which fields are none of a table's
    load_mapping(path)
    return False


def read_mapped(path: Path, mapping: Path, *, gaps: str) -> tuple[Mapping[str, Series], Notes]:
    """A recording's table (CSV, Parquet, MF4) by a mapping of its columns (``--signals``).

    As strict as with canonical names: time that goes back and holes are refused (holes marked,
    where ``gaps`` says so).
    """
    wanted = load_columns(mapping)
    if path.suffix.lower() == ".mf4":
        series, notes = _mf4(path, wanted, gaps=gaps)
        return series, (*notes, *_ambiguous(series, wanted))
    table = _named(path, wanted.columns)
    if wanted.time == Column(TIME) and TIME not in table.names and TIME_NS in table.names:
        wanted = replace(wanted, time=Column(TIME_NS, 1e-9))
        table = _named(path, wanted.columns)
    where = f"column {' + '.join(wanted.time.columns)}"
    time = _seconds(path, table, wanted.time)
    t_ns = stamps_from_seconds(path, time, table.place, column=where)
    check_increasing(path, t_ns, table.place, column=where)
    columns = {name: _value(path, table, one) for name, one in wanted.signals.items()}
    left = _left_out(table.names, wanted)
    series, notes = to_series(path, Table(t_ns, columns, table.place, left), gaps=gaps)
    return series, (*notes, *_ambiguous(series, wanted))


def _last_of_each(time: Floats) -> tuple[npt.NDArray[np.bool_], Notes]:
    """Of rows at the same instant (an event) the last one; rows that go back are left out."""
    there = np.isfinite(time)
    ahead = np.maximum.accumulate(np.where(there, time, -np.inf))
    back, none = int(np.count_nonzero(time < ahead)), int(np.count_nonzero(~there))
    counted = ((back, "go back in time"), (none, "have no time"))
    notes = tuple(f"{count} rows {what}: left out" for count, what in counted if count)
    forward = np.flatnonzero(there & (time >= ahead))
    last = np.append(np.diff(time[forward]) > 0.0, True)[: len(forward)]
    keep = np.zeros(len(time), dtype=bool)
    keep[forward[last]] = True
    return keep, notes


def _named(path: Path, wanted: Sequence[str] | None) -> NamedColumns:
    if path.suffix.lower() == ".parquet":
        from eps_hil.recordings.parquet_file import read_named

        return read_named(path, wanted)
    from eps_hil.recordings.text_table import read_text

    return read_text(path, wanted)


def _seconds(path: Path, table: NamedColumns, time: Column) -> Floats:
    if table.instants and time.scale != 1.0:
        place = f"column {shown(time.column)}"
        problem = f"holds instants or durations, which no scale ({time.scale:g}) makes seconds"
        raise InputError(path, place, problem, "leave out its scale")
    return _value(path, table, time)


def _value(path: Path, table: NamedColumns, source: Column) -> Floats:
    for name in source.columns:
        if name not in table.columns:
            known = ", ".join(name for name in table.names[:_SHOWN] if name)
            raise InputError(path, f"column {shown(name)}", "is missing", f"there are: {known}")
    return source.value([table.columns[name] for name in source.columns])


def _left_out(names: Sequence[str], wanted: Columns) -> Notes:
    left = [name or "one without a name" for name in names if name not in wanted.columns]
    more = f" and {len(left) - _SHOWN} more" if len(left) > _SHOWN else ""
    return (f"columns left out: {', '.join(left[:_SHOWN])}{more}",) if left else ()


def read_table(path: Path) -> dict[str, Floats]:
    """All columns of numbers of a text table or Parquet file, by the names of that tool."""
    return dict(_named(path, None).columns)


def _mf4(
    path: Path, wanted: Columns, *, gaps: str, events: bool = False
) -> tuple[dict[str, Series], Notes]:
    """The mapped channels, each on its own stamps, as those of canonical names are."""
    from eps_hil.recordings.mf4_channels import missing_channel, read_channels

    clock, own = wanted.time.columns, wanted.time == Column(TIME)
    asked = [name for name in wanted.columns if not (own and name == TIME)]
    found = read_channels(path, asked, clock=() if own else clock, events=events)
    notes: Notes = ()
    if not own and not any(name in found.series for name in clock):
        notes += (f"time is the file's own, in seconds: no channel {shown(clock[0])} beside it",)
        own = True
    for name in dict.fromkeys(n for one in wanted.signals.values() for n in one.columns):
        if name not in found.series:
            raise missing_channel(path, name, found)
        bad = np.isnan(found.series[name].value)
        if bad.any() and gaps == "refuse":
            where = f"sample {int(np.argmax(bad)) + 1}, channel {shown(name)}"
            raise InputError(path, where, "is NaN, infinite or marked invalid", MARK_REMEDY)
        if bad.any():
            notes += (f"channel {shown(name)}: {np.count_nonzero(bad)} bad samples marked",)
    stamps = {} if own else _stamps(path, wanted.time, found.series, found.group)
    series = {}
    for name, source in wanted.signals.items():
        parts = [found.series[one] for one in source.columns]
        if not own:
            parts = [
                Series(_own_stamps(path, one, found.group[one], stamps), part.value)
                for one, part in zip(source.columns, parts, strict=True)
            ]
        t_ns, values, more = _together(path, name, source, parts)
        notes += more
        missing = np.isnan(values).any(axis=0) if more else np.zeros(len(t_ns), dtype=bool)
        if missing.any() and gaps == "refuse":
            where = f"sample {int(np.argmax(missing)) + 1}, {name}"
            raise InputError(path, where, "a part of the sum is missing", MARK_REMEDY)
        series[name] = Series(t_ns, source.value(values))
    return series, (*_left_out(found.names, wanted), *notes)


def _stamps(
    path: Path, time: Column, series: Mapping[str, Series], group: Mapping[str, int]
) -> dict[int, npt.NDArray[np.int64]]:
    """Stamps of the channel group that a time channel is in."""

    def place(row: int) -> str:
        return f"sample {row + 1}"

    for name in time.columns:
        if name not in series or group[name] != group[time.columns[0]]:
            raise InputError(path, f"channel {shown(name)}", "is missing", "correct time")
    where = f"channel {' + '.join(time.columns)}"
    seconds = time.value([series[name].value for name in time.columns])
    t_ns = stamps_from_seconds(path, seconds, place, column=where)
    check_increasing(path, t_ns, place, column=where)
    return {group[time.columns[0]]: t_ns}


def _own_stamps(
    path: Path, name: str, group: int, stamps: Mapping[int, npt.NDArray[np.int64]]
) -> npt.NDArray[np.int64]:
    if group not in stamps:
        problem = "is not in the channel group of the time channel"
        remedy = "leave out 'time': the file has its own"
        raise InputError(path, f"channel {shown(name)}", problem, remedy)
    return stamps[group]


def _together(
    path: Path, name: str, source: Column, parts: Sequence[Series]
) -> tuple[npt.NDArray[np.int64], list[Floats], Notes]:
    """The parts of a sum at the same stamps: those of the part that has most."""
    densest = max(parts, key=lambda one: len(one.t_ns))
    t_ns = densest.t_ns
    if all(np.array_equal(one.t_ns, t_ns) for one in parts):
        return t_ns, [one.value for one in parts], ()
    what = f"{name}: the channels {', '.join(map(shown, source.sum))} have other stamps"
    if source.counts_per_turn is not None:
        raise InputError(path, "", what, "counts that begin anew cannot be put together")
    since, until = max(one.t_ns[0] for one in parts), min(one.t_ns[-1] for one in parts)
    t_ns = t_ns[(t_ns >= since) & (t_ns <= until)]
    if not len(t_ns):
        raise InputError(path, "", f"{what}, and no time in common", "map one of them")
    values = [linear(one, t_ns) for one in parts]
    return t_ns, values, (f"{what}: added at those of one, linear between the others' samples",)


def _ambiguous(series: Mapping[str, Series], wanted: Columns) -> Notes:
    """What is not known of angles that were counted: turns between samples that lie far apart."""
    notes: Notes = ()
    for name, source in wanted.signals.items():
        one = series.get(name)
        if source.counts_per_turn is None or one is None:
            continue
        good = np.isfinite(one.value)
        t_ns, turns = one.t_ns[good], one.value[good] / (2.0 * np.pi * source.scale)
        if len(t_ns) < 2:
            continue
        step, most = np.diff(t_ns), float(np.abs(np.diff(turns)).max())
        if most > _LARGEST_STEP and most <= 0.5 + 1e-9:
            notes += (
                f"{name}: up to {most:.2f} turns between two samples: "
                "beyond 0.5 the counts hide a turn",
            )
        gap = float(step.max())
        if gap > longest_step_ns(t_ns):
            notes += (f"{name}: whole turns in a gap of {gap * 1e-9:.3g} s are not counted",)
    return notes
