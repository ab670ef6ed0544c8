"""``eps-hil compare REC``: what friction compensation and extensions are worth on a recording."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eps_hil.cli._first_answer import say_if_it_compiles
from eps_hil.cli._inputs import ModelPath, Reading, read_recording, reads_recordings, waiting

if TYPE_CHECKING:
    from eps_hil.report.comparison import Candidate


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("compare")(reads_recordings(compare))


def compare(
    recording: Annotated[
        Path, typer.Argument(metavar="REC", help="Rig recording that holds the load cell.")
    ],
    model: ModelPath,
    live: Annotated[
        Path | None,
        typer.Option("--live", help="Estimates of the same time: run --log-estimates FILE."),
    ] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Draw rack force over time (.png, .svg, .pdf).")
    ] = None,
    zoom: Annotated[
        list[str] | None,
        typer.Option("--zoom", metavar="FROM:TO", help="Further panel, in s; may repeat."),
    ] = None,
    second: Annotated[
        bool,
        typer.Option("--second", help="Beside the paper's: bristle filter and smoother."),
    ] = False,
    json: Annotated[Path | None, typer.Option("--json", help="The table as JSON.")] = None,
    settings: Annotated[
        Path | None, typer.Option("--settings", help="Estimator settings (YAML).")
    ] = None,
    *,
    reading: Reading,
) -> None:
    """Compare the estimator's variants with the load cell: table, and figure if asked for.

    Runs the recording through the estimator with and without friction compensation, and with and
    without dead zone and limiter. --live adds what a running service made of it.
    """
    import eps_hil
    from eps_hil.cli._files import check_kept, write_json
    from eps_hil.estimation.settings import EstimatorSettings
    from eps_hil.physics.model import load_model
    from eps_hil.report import comparison, figures
    from eps_hil.report.comparison_figure import draw
    from eps_hil.yaml_file import load

    if figure:
        figures.check(figure)
    check_kept((json,), (recording, model, live, settings, *reading.files()))
    zooms = [_zoom(text) for text in zoom or []]
    rig = load_model(model)
    chosen = load(settings, EstimatorSettings) if settings else EstimatorSettings()
    published = comparison.read_published(live) if live else None
    read = read_recording(recording, reading)
    given = eps_hil.Recording(read.name, read.series, read.notes, read.arrivals, read.pace)
    say_if_it_compiles()
    with waiting("estimating with and without"):
        found = eps_hil.compare(given, rig, chosen, published=published, second=second)
    candidates = list(found.candidates)
    _say(candidates)
    if json:
        write_json(
            json,
            {
                "schema": "eps-hil/compare/1",
                "recording": str(recording),
                "rms_of_rack_force_n": candidates[0].score.rms_force_n,
                "estimates": comparison.summary(candidates),
            },
        )
    if figure:
        begin_ns = comparison.start_ns(read.series)
        cell = read.series["rack_force_n"]
        with waiting("drawing"):
            where = draw(candidates, cell, rig, figure, begin_ns=begin_ns, zooms=zooms)
        typer.echo(f"figure: {where}")


def _zoom(text: str) -> tuple[float, float]:
    since, _, until = text.partition(":")
    try:
        span = (float(since), float(until))
    except ValueError:
        span = (0.0, 0.0)
    if not 0.0 <= span[0] < span[1] < math.inf:
        raise typer.BadParameter(f"'{text}' is not FROM:TO in seconds", param_hint="'--zoom'")
    return span


def _say(candidates: "list[Candidate]") -> None:
    from rich.console import Console
    from rich.table import Table

    from eps_hil.report.comparison import DESCRIPTIONS

    table = Table(
        title="rack force: rms error against the load cell, in N", title_justify="left", box=None
    )
    table.add_column("estimate")
    for heading in ("overall", "moving", "at rest", "valid"):
        table.add_column(heading, justify="right")
    table.add_column("with")
    for one in candidates:
        numbers = (one.score.rmse_overall_n, one.score.rmse_moving_n, one.score.rmse_resting_n)
        cells = [f"{number:.1f}" for number in numbers]
        valid = f"{100 * one.trace.valid.mean():.1f} %"
        table.add_row(one.name, *cells, valid, DESCRIPTIONS[one.name])
    console = Console(width=100, highlight=False)
    console.print(table)
    typer.echo(f"the load cell itself: {candidates[0].score.rms_force_n:.1f} N rms")
