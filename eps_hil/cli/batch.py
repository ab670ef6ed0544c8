"""``eps-hil batch estimate|identify|diagnose|changes``: one job over a folder or a table."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eps_hil.cli._first_answer import say_if_it_compiles
from eps_hil.cli._inputs import ModelPath, Reading, reads_recordings
from eps_hil.errors import EpsHilError

if TYPE_CHECKING:
    from eps_hil.fleet.job import Row, Verb

Source = Annotated[
    Path, typer.Argument(metavar="FOLDER|TABLE", help="Recordings below it, or CSV: path, unit.")
]
States = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER|TABLE",
        help="UNIT/before and UNIT/after with recordings, or CSV: path, unit, state.",
    ),
]
Out = Annotated[Path, typer.Option("--out", help="Folder of the results; run again to go on.")]
Processes = Annotated[
    int | None, typer.Option("--processes", min=1, help="Default: one for each core.")
]
Dask = Annotated[
    str | None,
    typer.Option("--dask", help="Scheduler of a Dask cluster that sees the same files."),
]
Retry = Annotated[
    bool, typer.Option("--retry-failed", help="Try recordings again that failed before.")
]
Settings = Annotated[Path | None, typer.Option("--settings", help="Estimator settings (YAML).")]


class NothingDoneError(EpsHilError):
    """Not one recording, or unit, of a batch could be used."""


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    group = typer.Typer(no_args_is_help=True, help="One job over many recordings.")
    for verb in (estimate, identify, diagnose, changes):
        group.command(verb.__name__)(reads_recordings(verb))
    app.add_typer(group, name="batch")


def estimate(
    source: Source,
    model: ModelPath,
    out: Out,
    settings: Settings = None,
    processes: Processes = None,
    dask: Dask = None,
    retry_failed: Retry = False,
    *,
    reading: Reading,
) -> None:
    """Estimate the rack force of every recording; each one's estimates go to OUT/estimates."""
    _run("estimate", source, model, out, settings, processes, dask, retry_failed, reading)


def identify(
    source: Source,
    model: ModelPath,
    out: Out,
    processes: Processes = None,
    dask: Dask = None,
    retry_failed: Retry = False,
    *,
    reading: Reading,
) -> None:
    """Identify the parameters of every recording by itself, with 95 % intervals."""
    _run("identify", source, model, out, None, processes, dask, retry_failed, reading)


def diagnose(
    source: Source,
    model: ModelPath,
    out: Out,
    processes: Processes = None,
    dask: Dask = None,
    retry_failed: Retry = False,
    *,
    reading: Reading,
) -> None:
    """Diagnose which physics the model lacks, in every recording by itself."""
    _run("diagnose", source, model, out, None, processes, dask, retry_failed, reading)


def changes(
    source: States,
    model: ModelPath,
    out: Out,
    processes: Processes = None,
    dask: Dask = None,
    retry_failed: Retry = False,
    *,
    reading: Reading,
) -> None:
    """What has changed in every unit between its recordings before and after?"""
    _run("changes", source, model, out, None, processes, dask, retry_failed, reading)


def _run(
    verb: "Verb",
    source: Path,
    model: Path,
    out: Path,
    settings: Path | None,
    processes: int | None,
    dask: str | None,
    retry: bool,
    reading: Reading,
) -> None:
    from eps_hil.fleet import population_page, workers
    from eps_hil.fleet.batch import run_batch
    from eps_hil.fleet.job import Job
    from eps_hil.fleet.tasks import states_of, tasks_of
    from eps_hil.physics.model import load_model
    from eps_hil.recordings.files import check_readable, make_folder

    workers.check(dask)
    for path in reading.files():
        if path is not None:
            check_readable(path)
    load_model(model)  # refused here, and not once for each recording
    if settings is not None:
        from eps_hil import yaml_file
        from eps_hil.estimation.settings import EstimatorSettings

        yaml_file.load(settings, EstimatorSettings)
    what = "unit" if verb == "changes" else "recording"
    tasks = (states_of if what == "unit" else tasks_of)(source.resolve(), out)
    make_folder(out, "--out")
    asked = reading.arguments()
    named = {"dbc": [str(path.resolve()) for path in reading.dbc], "signals": None}
    if reading.signals is not None:
        named["signals"] = str(reading.signals.resolve())  # type: ignore[assignment]
    job = Job(
        verb, model.resolve(), out.resolve(), settings and settings.resolve(), {**asked, **named}
    )
    batch = run_batch(
        job,
        tasks,
        processes=processes,
        dask=dask,
        retry=retry,
        on_row=_teller(what),
        begin=say_if_it_compiles,
    )
    report = population_page.write(batch, out / "population.html", f"{verb}: {source}")
    failed, noted = len(batch.failed), sum(bool(row.get("notes")) for row in batch.rows)
    written = [batch.results, batch.values, *([batch.changes] if batch.changes else []), report]
    typer.echo(
        f"{len(batch.rows)} {what}s, {batch.before} of them known "
        f"before, {failed} failed, {noted} with notes of the reader: {', '.join(map(str, written))}"
        + "; to try failed ones again, give --retry-failed"
        * bool(failed)
    )
    if failed == len(batch.rows):
        raise NothingDoneError(f"not one {what} could be used: {batch.failed[0]['error']}")


def _teller(by: str) -> "Callable[[Row, int, int], None]":
    """Names each row by its unit, or by its recording's file."""

    def tell(row: "Row", done: int, of: int) -> None:
        name = row["unit"] if by == "unit" else Path(row["recording"]).name
        typer.echo(f"{done}/{of} {name}: {row['error'] or 'done'}", err=True)

    return tell
