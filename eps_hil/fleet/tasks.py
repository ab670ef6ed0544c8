"""Which recordings a batch is of: the files of a folder, or the rows of a table."""

import csv
from dataclasses import dataclass
from pathlib import Path

from eps_hil.errors import InputError
from eps_hil.recordings.read import SUFFIXES

PATH, UNIT = "path", "unit"
PLACES = ("rows", "estimates", "identifications", "diagnoses", "results.parquet", "values.parquet")
"""What a batch writes recordings' results to, in its folder."""


@dataclass(frozen=True, slots=True)
class Task:
    """One recording, and the rig (or car, or motor) that it is of."""

    path: Path
    unit: str


def tasks_of(source: Path, out: Path | None = None) -> list[Task]:
    """Every recording below a folder, or every row of a CSV table, sorted by path.

    In a folder the unit is the first folder below it, else the file's name; what begins with a dot
    (files half written, too) and what a batch wrote to ``out`` is no recording. A table has the
    column ``path`` (relative to itself) and may have ``unit``; other columns are left alone. A file
    that is not there is a task too: it fails by itself. :class:`InputError` for a source without
    any.
    """
    tasks = _of_folder(source, out) if source.is_dir() else _of_table(source)
    if not tasks:
        known = ", ".join(SUFFIXES)
        raise InputError(source, "", "holds no recording", f"known suffixes: {known}")
    return sorted(tasks, key=lambda task: str(task.path))


def _of_folder(folder: Path, out: Path | None) -> list[Task]:
    whole = folder.resolve()
    results = set() if out is None else set(_results(whole, out.resolve()))
    found = []
    for path in folder.rglob("*"):
        below = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in below.parts)
        if path.suffix.lower() not in SUFFIXES or hidden or not path.is_file():
            continue
        if not results & {whole / below, *(whole / below).parents}:
            found.append(Task(path, _unit(below)))
    return found


def _results(folder: Path, out: Path) -> list[Path]:
    """What a batch of the folder writes: all of ``out``, unless the recordings lie in that."""
    inside = folder == out or out in folder.parents
    return [out / name for name in PLACES] if inside else [out]


def _unit(path: Path) -> str:
    return path.parts[0] if len(path.parts) > 1 else path.stem


def _of_table(table: Path) -> list[Task]:
    try:
        with table.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            if PATH not in (reader.fieldnames or ()):
                problem = f"column {PATH} is missing"
                raise InputError(table, "line 1", problem, "name the recordings there")
            rows = [row for row in reader if (row[PATH] or "").strip()]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        said = getattr(error, "strerror", None) or str(error)
        problem = f"cannot be read: {said}"
        raise InputError(table, "", problem, "give a folder of recordings or a CSV table") from None
    tasks = []
    for row in rows:
        path = table.parent / row[PATH].strip()
        tasks.append(Task(path, (row.get(UNIT) or "").strip() or path.stem))
    return tasks
