"""Which recordings a batch is of: the files of a folder, or the rows of a table."""

import csv
from dataclasses import dataclass
from pathlib import Path

from eps_hil.errors import InputError
from eps_hil.recordings.read import SUFFIXES

PATH, UNIT = "path", "unit"


@dataclass(frozen=True, slots=True)
class Task:
    """One recording, and the rig (or car, or motor) that it is of."""

    path: Path
    unit: str


def tasks_of(source: Path) -> list[Task]:
    """Every recording below a folder, or every row of a CSV table, sorted by path.

    In a folder the unit is the first folder below it, else the file's name. A table has the column
    ``path`` (relative to itself) and may have ``unit``; other columns are left alone. A file that
    is not there is a task too: it fails by itself. :class:`InputError` for a source without any.
    """
    tasks = _of_folder(source) if source.is_dir() else _of_table(source)
    if not tasks:
        known = ", ".join(SUFFIXES)
        raise InputError(source, "", "holds no recording", f"known suffixes: {known}")
    return sorted(tasks, key=lambda task: str(task.path))


def _of_folder(folder: Path) -> list[Task]:
    found = (path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    return [Task(path, _unit(path.relative_to(folder))) for path in found if path.is_file()]


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
