"""Tables of canonical columns: what is checked, and what an empty cell means, whatever the format.

A table has one row per time stamp. Signals of different rates share it by leaving cells empty, so
an empty cell may be "no sample at that time" (harmless) or a hole in the data (refused, or marked
as a bad sample). :func:`to_series` tells the two apart by the company a signal keeps: a signal
that is there in more than half of the rows in which some other signal is there belongs with it,
and is missing where only the other one is found. With one full column beside it this is the plain
rule "at most half of the cells filled: another rate; more: a hole". Before a signal's first sample
it is simply not there yet.
"""

import difflib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.errors import InputError
from eps_hil.series import Series
from eps_hil.signals import CANONICAL, PUBLISHED, TIME

TIME_NS = "time_ns"
"""Optional exact companion of ``time_s`` (int64), written where a float cannot hold the stamp."""
VALID = "valid"
"""0/1 beside a published estimate: status, not a signal of its own."""

EPOCH_S = 1e6
"""From here on t * 1e9 may miss the nanosecond that a decimal text names: parse the text."""

ESTIMATES = PUBLISHED
_NS = 1_000_000_000
_EXACT_S = 2**53 / _NS  # up to here a float of seconds names every nanosecond
_RANGE_S = 9.2e9  # what fits into int64 nanoseconds
MARK_REMEDY = "give --gaps mark to keep it as a bad sample"

Floats = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Table:
    """Rows as read: ``t_ns`` (n,) strictly increasing, every column (n,).

    A cell is NaN where the file has none and infinite where it holds something that is not a
    finite number; ``place`` names row i for a person ("line 17").
    """

    t_ns: Stamps
    columns: Mapping[str, Floats]
    place: Callable[[int], str]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class NamedColumns:
    """Columns (n,) of a table by the names that its tool gave them; ``names``: of all it has.

    Cells are as in :class:`Table`. ``instants``: the first that was asked for holds dates or
    durations, here in seconds.
    """

    names: tuple[str, ...]
    columns: Mapping[str, Floats]
    place: Callable[[int], str]
    instants: bool = False


def check_once(
    path: Path, place: str, names: Sequence[str], wanted: Collection[str], what: str = "column"
) -> None:
    """Refuse what is asked for and there twice: nobody says which is meant."""
    for k, name in enumerate(names):
        if name in wanted and name in names[:k]:
            raise InputError(path, place, f"{what} {shown(name)} is there twice", "remove one")


def usable_columns(
    path: Path, names: Sequence[str], place: str, *, ignore_unknown: bool
) -> tuple[dict[str, int], tuple[str, ...]]:
    """Index of every column that we know, by name; :class:`InputError` for what is wrong."""
    found: dict[str, int] = {}
    unknown = []
    for index, name in enumerate(names):
        if name in found:
            raise InputError(path, place, f"column {shown(name)} is there twice", "remove one")
        if name in CANONICAL or name in (TIME, TIME_NS, VALID):
            found[name] = index
        elif ignore_unknown:
            unknown.append(name)
        else:
            problem = f"column {shown(name)} is not a canonical name"
            raise InputError(path, place, problem, _renaming(name))
    if TIME not in found and TIME_NS not in found:
        raise InputError(path, place, f"column {TIME} is missing", "add the time in seconds")
    if not any(name in CANONICAL for name in found):
        raise InputError(path, place, "no column holds a canonical signal", _known_names())
    notes = (f"columns left out: {', '.join(map(shown, unknown))}",) if unknown else ()
    return found, notes


def stamps_from_seconds(
    path: Path,
    seconds: Floats,
    place: Callable[[int], str],
    *,
    column: str = f"column {TIME}",
) -> Stamps:
    """Seconds, shape (n,), to integer nanoseconds.

    Beyond 2^53 ns (epoch times) a float resolves 0.24 us, so stamps are rounded to microseconds.
    """
    largest_second(path, seconds, place, column=column)
    return seconds_to_ns(seconds)


def clocks_apart(seconds: Floats | None, t_ns: Stamps) -> tuple[str, ...]:
    """A note where ``time_s`` (n,) says something else than ``time_ns`` (n,), which counts."""
    if seconds is None:
        return ()
    apart = np.abs(seconds - t_ns / _NS)
    most = float(np.max(apart, initial=0.0, where=np.isfinite(apart)))
    if most < _SAME_S:
        return ()
    return (f"{TIME} and {TIME_NS} are up to {most:.3g} s apart: {TIME_NS} is taken",)


def other_unit(name: str, said: str) -> tuple[str, ...]:
    """A note where a file says that a canonical signal has another unit than its name does."""
    known = CANONICAL.get(name)
    plain = _plain_unit(said)
    if known is None or not plain or plain in (_plain_unit(known.unit), *_SAME.get(known.unit, ())):
        return ()
    return (f"{name}: the file says that its unit is {shown(said)}: taken as {known.unit}",)


_SAME_S = 2e-6
"""What floats of seconds may differ by from the stamps that they name."""
_SAME = {"degC": ("c", "degreecelsius", "celsius"), "rad/s": ("1/s", "rad/sec"), "rad": ("1",)}


def _plain_unit(unit: str) -> str:
    text = unit.strip().strip("[]()").lower().replace("°", "deg").replace("²", "2")
    return "".join(sign for sign in text if sign not in " ·*^")


def largest_second(
    path: Path,
    seconds: Floats,
    place: Callable[[int], str],
    *,
    column: str = f"column {TIME}",
) -> float:
    """Of a column of times, shape (n,), the one farthest from 0; its size.

    :class:`InputError` where one is none.
    """
    size = np.abs(seconds)
    most = float(size.max(initial=0.0))
    if not most < _RANGE_S:
        row = int(np.argmin(size < _RANGE_S))
        what = "is empty" if np.isnan(seconds[row]) else "is not a time in seconds"
        raise InputError(path, f"{place(row)}, {column}", what, "every row needs its time")
    return most


def seconds_to_ns(seconds: Floats) -> Stamps:
    """What a column of float seconds, shape (n,), says in integer nanoseconds (all finite)."""
    if np.abs(seconds).max(initial=0.0) < _EXACT_S:
        return np.rint(seconds * _NS).astype(np.int64)
    return np.rint(seconds * 1e6).astype(np.int64) * 1000


def check_increasing(
    path: Path, t_ns: Stamps, place: Callable[[int], str], *, column: str = f"column {TIME}"
) -> None:
    """Refuse time that repeats or goes backwards, naming the row."""
    late = np.diff(t_ns) <= 0
    if late.any():
        row = int(np.argmax(late)) + 1
        now, before = t_ns[row] / _NS, t_ns[row - 1] / _NS
        how = "repeats at" if now == before else f"goes back from {before} s to"
        problem = f"time {how} {now} s"
        raise InputError(path, f"{place(row)}, {column}", problem, "sort or split the file")


_SLOWER, _FEWEST = 1.5, 20
"""Times the rows' step: a signal with such a step of its own, and so many samples, is slower."""


def to_series(path: Path, table: Table, *, gaps: str) -> tuple[dict[str, Series], tuple[str, ...]]:
    """Every column as a :class:`Series` of its own samples, and notes on what was left or marked.

    ``gaps``: "refuse" raises :class:`InputError` at the first hole or non-finite value; "mark"
    keeps them as samples with the value NaN.
    """
    if len(table.t_ns) and all(np.isfinite(one).all() for one in table.columns.values()):
        return {name: Series(table.t_ns, one) for name, one in table.columns.items()}, table.notes
    filled = {name: ~np.isnan(column) for name, column in table.columns.items()}
    holes = _holes(filled, table.t_ns)
    excused = _said_invalid(table)
    bad: dict[str, Flags] = {}
    for name, column in table.columns.items():
        bad[name] = np.isinf(column) | holes[name]
        if name in ESTIMATES:
            bad[name] &= ~excused
    notes = list(table.notes)
    if gaps == "refuse":
        _refuse(path, table, bad)
    series = {}
    for name, column in table.columns.items():
        kept = filled[name] | holes[name]
        if name in ESTIMATES:
            kept |= excused
        if not filled[name].any():
            notes.append(f"column {name} has no value: left out")
            continue
        whole = bool(kept.all())  # then stamps are shared: an hour of them is 30 MB a signal
        value = column if whole else column[kept]
        if np.isinf(value).any():
            value = np.where(np.isinf(value), np.nan, value)
        if (marked := int(np.count_nonzero(bad[name]))) > 0:
            notes.append(f"column {name}: {marked} bad samples marked")
        series[name] = Series(table.t_ns if whole else table.t_ns[kept], value)
    return series, tuple(notes)


def from_series(series: Mapping[str, Series]) -> tuple[Stamps, dict[str, Floats]]:
    """The table that holds every sample: rows at the union of all stamps, NaN where there is none.

    Read back through :func:`to_series` it gives the same series.
    """
    t_ns = np.unique(np.concatenate([one.t_ns for one in series.values()]))
    columns = {}
    for name, one in series.items():
        column = np.full(len(t_ns), np.nan)
        column[np.searchsorted(t_ns, one.t_ns)] = one.value
        columns[name] = column
    return t_ns, columns


def shown(text: object) -> str:
    """A name or cell as it may stand in an error: quoted, printable, short."""
    quoted = ascii(str(text)) if not str(text).isprintable() else f"'{text}'"
    return quoted if len(quoted) <= 40 else quoted[:36] + "...'"


def _holes(filled: Mapping[str, Flags], t_ns: Stamps) -> dict[str, Flags]:
    holes = {name: np.zeros(len(t_ns), dtype=bool) for name in filled}
    sparse = [name for name, there in filled.items() if not there.all()]
    if not sparse:
        return holes
    nothing = ~np.logical_or.reduce(list(filled.values()))
    for name in sparse:
        there = filled[name]
        for other, company in filled.items():
            if other != name and _belongs(there[company], t_ns[company]):
                holes[name] |= company & ~there
        if _belongs(there, t_ns):
            holes[name] |= nothing
        if there.any():
            holes[name][: int(np.argmax(there))] = False  # it starts later: no hole
    return holes


def _belongs(there: Flags, t_ns: Stamps) -> bool:
    """Whether a signal is expected in rows at ``t_ns`` of which it fills ``there``.

    Not one of half their rate, which fills more than half of them where rows are lost.
    """
    twice, own = 2 * int(np.count_nonzero(there)), t_ns[there]
    if len(own) >= _FEWEST and twice > len(there):
        return float(np.median(np.diff(own))) < _SLOWER * float(np.median(np.diff(t_ns)))
    if twice == len(there) + 1:  # every other row, first and last included: half the rate
        return bool((there[1:] & there[:-1]).any()) or len(there) == 1
    return twice > len(there)


def _said_invalid(table: Table) -> Flags:
    """Rows in which the file itself says that the estimate does not hold: no surprise there."""
    if VALID not in table.columns:
        return np.zeros(len(table.t_ns), dtype=bool)
    return np.asarray(table.columns[VALID] == 0.0)


def _refuse(path: Path, table: Table, bad: Mapping[str, Flags]) -> None:
    first = {name: int(np.argmax(flags)) for name, flags in bad.items() if flags.any()}
    if not first:
        return
    name = min(first, key=first.__getitem__)
    row = first[name]
    empty = np.isnan(table.columns[name][row])
    what = "is empty in a filled column" if empty else "is NaN or infinite"
    raise InputError(path, f"{table.place(row)}, column {name}", what, MARK_REMEDY)


def _renaming(name: str) -> str:
    if not name.strip():
        return "name it or remove it"
    plain = name.strip().lower().replace(" ", "_")
    near = difflib.get_close_matches(plain, [TIME, *CANONICAL], n=1, cutoff=0.5)
    remedy = f"rename it to {near[0]}" if near else f"rename it ({_known_names()})"
    return f"{remedy}, or give --ignore-unknown"


def _known_names() -> str:
    return f"known names: {', '.join([TIME, *CANONICAL])}"
