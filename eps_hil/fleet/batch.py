"""A whole batch: what is known already, what is to do, rows, tables and page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from eps_hil.fleet import workers
from eps_hil.fleet.job import Job, Row
from eps_hil.fleet.store import Store
from eps_hil.fleet.tasks import Task


@dataclass(frozen=True, slots=True)
class Batch:
    """Rows in the order of the tasks, how many of them were there before, and the tables."""

    rows: tuple[Row, ...]
    before: int
    results: Path
    values: Path
    changes: Path | None = None

    @property
    def failed(self) -> tuple[Row, ...]:
        """Rows of recordings, or units, that could not be used."""
        return tuple(row for row in self.rows if row["state"] != "done")


def run_batch(
    job: Job,
    tasks: Sequence[Task],
    *,
    processes: int | None = None,
    dask: str | None = None,
    retry: bool = False,
    on_row: Callable[[Row, int, int], None] | None = None,
    begin: workers.Begin = None,
) -> Batch:
    """Do what is not done yet. Each row is kept as it comes, so an end in the middle loses none.

    ``retry``: what failed is tried again, too. ``on_row`` hears each new row, how many are done and
    how many there are. Each process of this machine calls ``begin`` first.
    """
    store = Store(job.out)
    keys = {job.key(task): task for task in tasks}
    known = {key: row for key in keys if (row := store.known(key)) is not None}
    rows = {key: row for key, row in known.items() if row["state"] == "done" or not retry}
    before = len(rows)
    todo = [(task, key) for key, task in keys.items() if key not in rows]
    if todo:
        made = (
            workers.here(job, todo, processes, begin) if dask is None
            else workers.on_dask(job, todo, dask)
        )  # fmt: skip
        for row in made:
            store.keep(row)
            rows[row["key"]] = row
            if on_row is not None:
                on_row(row, len(rows), len(keys))
    ordered = tuple(rows[key] for key in keys)
    return Batch(ordered, before, *store.tables(ordered, states=job.verb == "changes"))
