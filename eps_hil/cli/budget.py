"""``eps-hil budget``: where the estimate's error comes from, and which calibration pays next."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eps_hil.cli._files import check_kept, write_json
from eps_hil.cli._first_answer import say_if_it_compiles
from eps_hil.cli._inputs import ModelPath, progress
from eps_hil.cli.estimate import Kind
from eps_hil.unit_words import spaced

if TYPE_CHECKING:
    from eps_hil.budget.budget import Budget


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("budget")(budget)


def budget(
    model: ModelPath,
    uncertainty: Annotated[
        Path | None,
        typer.Option("--uncertainty", help="Sizes (YAML), or the JSON of eps-hil identify."),
    ] = None,
    manoeuvre: Annotated[
        str, typer.Option("--manoeuvre", help="Name or file; what the rig does meanwhile.")
    ] = "demo",
    chain: Annotated[
        Path | None, typer.Option("--chain", help="Masses and springs of the rig (YAML).")
    ] = None,
    order: Annotated[int, typer.Option("--order", min=1, max=5, help="Masses of the rig.")] = 5,
    kind: Annotated[
        Kind | None, typer.Option("--estimator", help="Which estimator; default: the settings'.")
    ] = None,
    settings: Annotated[
        Path | None, typer.Option("--settings", help="Estimator settings (YAML).")
    ] = None,
    angle: Annotated[
        bool, typer.Option("--angle/--no-angle", help="Whether the rotor angle is recorded too.")
    ] = True,
    draws: Annotated[
        int, typer.Option("--draws", min=4, max=10000, help="Draws of the Monte Carlo.")
    ] = 24,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="The same seed, the same figures.")
    ] = 0,
    json: Annotated[Path | None, typer.Option("--json", help="The budget as JSON.")] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="The budget as bars (.png, .svg, .pdf).")
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="The budget as one HTML page, for people.")
    ] = None,
) -> None:
    """Tell how much of the rack force's error comes from which calibration or sensor.

    Simulates the rig once, then runs the estimator under each error alone and under all together;
    newtons rms at the rack, apart for moving, reversals and rest. Without --uncertainty documented
    sizes are used.
    """
    from dataclasses import replace

    from eps_hil import yaml_file
    from eps_hil.budget import budget as budgets
    from eps_hil.budget.simulated import simulated_world
    from eps_hil.budget.uncertainty import Uncertainty, load_uncertainty, sources
    from eps_hil.errors import InputError
    from eps_hil.estimation.settings import EstimatorSettings, problem
    from eps_hil.physics.chain_parameters import load_chain
    from eps_hil.physics.model import load_model
    from eps_hil.report import figures, page
    from eps_hil.rig.assumed_chain import assumed_chain
    from eps_hil.rig.manoeuvre import load_manoeuvre

    if report:
        page.check("--report", "matplotlib")
    if figure:
        figures.check(figure)
    check_kept((json, report), (model, uncertainty, Path(manoeuvre), chain, settings))
    rig = load_model(model)
    chosen = yaml_file.load(settings, EstimatorSettings) if settings else EstimatorSettings()
    if kind is not None:
        chosen = replace(chosen, kind=kind.value)
    if wrong := problem(chosen, live=False):
        raise InputError(settings or "--estimator", "kind", wrong)
    given = load_uncertainty(uncertainty, rig) if uncertainty else Uncertainty()
    todo = sources(rig, given, angle)
    if not todo:
        raise InputError(
            uncertainty or "", "uncertainty", "every source is zero", "give one a size"
        )
    say_if_it_compiles()
    with progress("simulating the rig"):
        world = simulated_world(
            rig,
            chosen,
            load_chain(chain) if chain else assumed_chain(rig),
            load_manoeuvre(manoeuvre),
            order=order,
            angle=angle,
            periods_s=given.periods_s,
        )
    with progress("error budget") as bar:
        found = budgets.budget(world, todo, draws=draws, seed=seed, on_progress=bar)
    _say(found, manoeuvre)
    if json:
        write_json(json, {"model": str(model), "manoeuvre": manoeuvre, "estimator": chosen.kind}
                   | budgets.content(found))  # fmt: skip
    if figure:
        from eps_hil.budget.figure import draw

        title = f"{Path(model).stem}, {manoeuvre}: what one standard deviation of each source costs"
        typer.echo(f"figure: {draw(found, figure, title)}")
    if report:
        from eps_hil.budget.page import About, write

        write(found, report, About(str(model), manoeuvre, chosen.kind, order, angle))
        typer.echo(f"page: {report}")


def _say(found: "Budget", manoeuvre: str) -> None:
    from rich.console import Console
    from rich.table import Table

    from eps_hil.budget.budget import PHASES, advice

    console = Console(width=110, highlight=False)
    table = Table(
        title=f"error in N rms at the rack, {manoeuvre}: each source alone",
        title_justify="left",
        box=None,
    )
    table.add_column("source")
    table.add_column("one deviation", justify="right")
    for phase in PHASES:
        table.add_column(phase, justify="right")
    for line in found.sources:
        assert line.source is not None
        size = f"{line.source.size:.3g}{spaced(line.source.unit)}"
        table.add_row(line.name, size, *(_number(line.alone_n[phase]) for phase in PHASES))
    table.add_section()
    for name, values in (
        ("root of the squares", found.root_sum_n),
        (f"all together ({found.draws} draws)", found.total_n),
        ("the method itself", found.method_n),
        ("error with the method", found.with_method_n),
        ("the rack force", found.force_n),
    ):
        table.add_row(name, "", *(_number(values[phase]) for phase in PHASES))
    console.print(table)
    gains = Table(title="what putting a group right would gain, in N rms", title_justify="left",
                  box=None)  # fmt: skip
    gains.add_column("group")
    for phase in PHASES:
        gains.add_column(phase, justify="right")
    for line in found.groups:
        gains.add_row(line.name, *(_number((line.gain_n or {})[phase]) for phase in PHASES))
    console.print(gains)
    for sentence in advice(found):
        typer.echo(sentence)


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.1f}"
