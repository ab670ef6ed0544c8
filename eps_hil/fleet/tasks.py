"""Which recordings a batch is of: the files of a folder, or the rows of a table."""

import csv
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from eps_hil.errors import InputError
from eps_hil.recordings.read import SUFFIXES

PATH, UNIT, STATE = "path", "unit", "state"
BEFORE, AFTER = "before", "after"
PLACES = (
    "rows", "estimates", "identifications", "diagnoses", "changes",
    "results.parquet", "values.parquet", "changes.parquet",
)  # fmt: skip
"""What a batch writes recordings' results to, in its folder."""


@dataclass(frozen=True, slots=True)
class Task:
    """One recording, and the rig (or car, or motor) that it is of; or all of a unit's two states.

    ``before``, ``after``: the recordings of the states, in their order; ``path`` is the first of
    the second state. ``wrong``: why it cannot be done, in one line.
    """

    path: Path
    unit: str
    before: tuple[Path, ...] = ()
    after: tuple[Path, ...] = ()
    wrong: str = ""


def tasks_of(source: Path, out: Path | None = None) -> list[Task]:
    """Every recording below a folder, or every row of a CSV table, sorted by path.

    In a folder the unit is the first folder below it, else the file's name; what begins with a dot
    (files half written, too) and what a batch wrote to ``out`` is no recording. A table has the
    column ``path`` (relative to itself) and may have ``unit``; other columns are left alone. A file
    that is not there is a task too: it fails by itself. :class:`InputError` for a source without
    any.
    """
    if source.is_dir():
        tasks = [Task(path, _unit(below)) for path, below in _files(source, out)]
    else:
        tasks = [Task(*_of_row(source, row)) for _, row in _rows(source)]
    _check_some(source, tasks)
    return sorted(tasks, key=lambda task: str(task.path))


def states_of(source: Path, out: Path | None = None) -> list[Task]:
    """Every unit with the recordings of its states before and after, sorted by unit.

    In a folder the state is the first folder called so on the way to a recording (sorted by path);
    left out, the unit is as in :func:`tasks_of`. A table has the column ``state`` too, and keeps
    the order of its rows. A unit without one of the states is a task that fails by itself.
    :class:`InputError` where there is no state at all, or a table has another.
    """
    units: dict[str, dict[str, list[Path]]] = {}
    told = _states_of_folder(source, out) if source.is_dir() else _states_of_table(source)
    for path, unit, state in told:
        units.setdefault(unit, {}).setdefault(state, []).append(path)
    _check_some(source, units)
    if all(not states.keys() & {BEFORE, AFTER} for states in units.values()):
        problem = f"holds no folder called {BEFORE} or {AFTER}"
        remedy = f"lay recordings below UNIT/{BEFORE} and UNIT/{AFTER}, or give a CSV table"
        raise InputError(source, "", problem, remedy)
    return [_two_states(source, unit, states) for unit, states in sorted(units.items())]


def _two_states(source: Path, unit: str, states: Mapping[str, Sequence[Path]]) -> Task:
    first, second = (tuple(states.get(state, ())) for state in (BEFORE, AFTER))
    wrong: InputError | None = None
    if stray := states.get(""):
        problem = f"lies below no folder called {BEFORE} or {AFTER}"
        wrong = InputError(stray[0], "", problem, "move it there, or out of the batch")
    elif not (first and second):
        lacks = AFTER if first else BEFORE
        remedy = f"put some below {unit}/{lacks}" if source.is_dir() else "name some in the table"
        wrong = InputError(source, f"unit {unit}", f"no recording of the state {lacks}", remedy)
    else:
        wrong = _twice(first, second)
    every = (*second, *first, *states.get("", ()))
    return Task(every[0], unit, first, second, "" if wrong is None else str(wrong))


def _twice(first: Sequence[Path], second: Sequence[Path]) -> InputError | None:
    """A file that stands in both states, or twice in one: it would count as seen twice."""
    seen: dict[Path, str] = {}
    for state, paths in ((BEFORE, first), (AFTER, second)):
        for path in paths:
            other = seen.get(path.resolve())
            if other == state:
                return InputError(path, "", "is given twice", "name each recording once")
            if other is not None:
                problem = f"is both {BEFORE} and {AFTER}"
                return InputError(path, "", problem, "two states are compared")
            seen[path.resolve()] = state
    return None


def _states_of_folder(folder: Path, out: Path | None) -> Iterator[tuple[Path, str, str]]:
    for path, below in sorted(_files(folder, out)):
        names = [part.casefold() for part in below.parts[:-1]]
        places = [k for k, name in enumerate(names) if name in (BEFORE, AFTER)]
        if not places:
            yield path, _unit(below), ""
            continue
        k = places[0]
        yield path, _unit(Path(*below.parts[:k], *below.parts[k + 1 :])), names[k]


def _states_of_table(table: Path) -> Iterator[tuple[Path, str, str]]:
    for line, row in _rows(table, STATE):
        state = (row[STATE] or "").strip()
        if state.casefold() not in (BEFORE, AFTER):
            place, problem = f"line {line}, column {STATE}", f"'{state}' is no state"
            raise InputError(table, place, problem, f"{BEFORE} or {AFTER}")
        yield *_of_row(table, row), state.casefold()


def _check_some(source: Path, found: object) -> None:
    if not found:
        known = ", ".join(SUFFIXES)
        raise InputError(source, "", "holds no recording", f"known suffixes: {known}")


def _files(folder: Path, out: Path | None) -> list[tuple[Path, Path]]:
    """Recordings, and their paths below the folder."""
    whole = folder.resolve()
    results = set() if out is None else set(_results(whole, out.resolve()))
    found = []
    for path in _walked(folder):
        below = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in below.parts)
        if path.suffix.lower() not in SUFFIXES or hidden:
            continue
        if not any(results & {at, *at.parents} for at in (whole / below, path.resolve())):
            found.append((path, below))
    return found


def _walked(folder: Path) -> Iterator[Path]:
    """All files below, linked folders too: each folder once, by a way without links if it has one.

    A link to a folder above leads back here: it is not followed.
    """
    above = {folder.resolve(), *folder.resolve().parents}
    seen: set[Path] = set()
    plain, linked = [folder], deque[Path]()
    while plain or linked:
        at = plain.pop() if plain else linked.popleft()
        if at.resolve() in seen or (at != folder and at.resolve() in above):
            continue
        seen.add(at.resolve())
        for path in sorted(at.iterdir()):
            if path.is_dir():
                (linked if path.is_symlink() else plain).append(path)
            elif path.is_file():
                yield path


def _results(folder: Path, out: Path) -> list[Path]:
    """What a batch of the folder writes: all of ``out``, unless the recordings lie in that."""
    inside = folder == out or out in folder.parents
    return [out / name for name in PLACES] if inside else [out]


def _unit(path: Path) -> str:
    return path.parts[0] if len(path.parts) > 1 else path.stem


def _rows(table: Path, *more: str) -> list[tuple[int, dict[str, str]]]:
    """Rows with a path, and their lines; the table has the columns ``more``, too."""
    try:
        with table.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            for name in (PATH, *more):
                if name not in (reader.fieldnames or ()):
                    remedy = (
                        "name the recordings there" if name == PATH
                        else f"say {BEFORE} or {AFTER} of each recording there"
                    )  # fmt: skip
                    raise InputError(table, "line 1", f"column {name} is missing", remedy)
            return [(reader.line_num, row) for row in reader if (row[PATH] or "").strip()]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        said = getattr(error, "strerror", None) or str(error)
        problem = f"cannot be read: {said}"
        raise InputError(table, "", problem, "give a folder of recordings or a CSV table") from None


def _of_row(table: Path, row: Mapping[str, str]) -> tuple[Path, str]:
    path = table.parent / row[PATH].strip()
    return path, (row.get(UNIT) or "").strip() or path.stem
