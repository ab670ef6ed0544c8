"""``eps-hil programme FILE``: drive the rig through its identification, record it, identify."""

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eps_hil.board import Notice
from eps_hil.cli._first_answer import say_if_it_compiles
from eps_hil.errors import EpsHilError, InputError

if TYPE_CHECKING:
    from eps_hil.physics.model import Model
    from eps_hil.programme.run import OnProgress, Summary
    from eps_hil.programme.summary import Identified, Whole


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("programme")(programme)


def programme(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Programme file (YAML).")],
    config: Annotated[Path, typer.Option("--config", help="Configuration (bus, DBC, model).")],
    out: Annotated[Path, typer.Option("--out", help="Folder for logs and results.")],
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the programme that --out holds.")
    ] = False,
    write_model: Annotated[
        Path | None, typer.Option("--write-model", help="Model file with what was identified.")
    ] = None,
    cells_only: Annotated[
        bool, typer.Option("--cells-only", help="Friction from the cells' means, no more.")
    ] = False,
    json: Annotated[Path | None, typer.Option("--json", help="All results as JSON.")] = None,
) -> None:
    """Run every cell of speed and preload on the rig, both ways, record and identify.

    The rig must run and follow RIG_Command (the simulated one: eps-hil rig --manoeuvre idle
    --loop). Each cell is a log of its own; finished cells outlive an interruption, kill -9
    included. Ctrl-C brings speed and preload to zero first.
    """
    from eps_hil.bus.config import load_bus_setup
    from eps_hil.cli._bus_options import stop_on_signals
    from eps_hil.cli._files import check_kept, check_model_place, write_json
    from eps_hil.cli._inputs import progress
    from eps_hil.physics.model import load_model
    from eps_hil.programme.fingerprint import fingerprint
    from eps_hil.programme.plan import load_plan
    from eps_hil.programme.run import ProgrammeRun, prepare_folder
    from eps_hil.programme.summary import (
        content,
        counted_twice,
        identified,
        identify_logs,
        table_file,
    )
    from eps_hil.service.input_check import check_mapped

    check_kept((write_model, json), (file, config))
    check_model_place(write_model)
    setup = load_bus_setup(config)
    check_kept((write_model, json), (setup.model, setup.signals, *setup.dbc))
    model = load_model(setup.model)
    check_mapped(setup, model)
    plan = load_plan(file, model)
    if write_model and cells_only and (twice := counted_twice(model)):
        raise InputError(setup.model, "effects", twice, "leave --cells-only out, or take them off")
    run = ProgrammeRun(setup, model, plan, out)
    finished = prepare_folder(out, plan, fingerprint(setup, model), resume=resume)
    if finished:
        typer.echo(f"{len(finished)} of {len(plan.cells())} cells are there already, and good")
    with _progress(str(setup.bus), file.name) as on_progress:
        summary = run.run(finished, stop=stop_on_signals(), on_progress=on_progress)
    table_file(summary, out / "cells.csv")
    say_if_it_compiles()
    found = identified(summary, model)
    whole = None
    if not cells_only:
        with progress("identifying from the logs") as bar:
            whole = identify_logs(summary, setup, model, out, bar)
    try:  # written first: nobody may be there to read what is said
        if json:
            write_json(json, content(plan, summary, found, whole))
        if write_model:
            _write_model(write_model, model, found, whole)
    finally:
        _say(summary, model, found)
        if whole is not None:
            _say_whole(whole)
    if write_model:
        typer.echo(f"model written to {write_model}")
    typer.echo(f"logs and cells.csv: {out}")
    if not summary.accepted:
        raise EpsHilError(f"no cell of {len(summary.results)} may be used: nothing is identified")


@contextlib.contextmanager
def _progress(bus: str, title: str) -> "Iterator[OnProgress]":
    """Cell and phase while the programme runs, for a page and on a terminal's stderr."""
    notice, last = Notice("programme", bus, title), [0, 0]

    with _bar() as bar:

        def show(number: int, total: int, phase: str) -> None:
            last[:] = number - 1, total
            notice.put(text=f"cell {number} of {total}: {phase}", done=number - 1, of=total)
            if bar is not None:
                bar(number, total, phase)

        try:
            yield show
        except BaseException as error:
            notice.end(text=f"ended: {error or 'interrupted'}", done=last[0], of=last[1])
            raise
        notice.end(text="all cells are done", done=last[1], of=last[1])


@contextlib.contextmanager
def _bar() -> "Iterator[OnProgress | None]":
    """On stderr; None where that is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress

    columns = (*Progress.get_default_columns(), MofNCompleteColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("programme", total=None)

        def show(number: int, total: int, phase: str) -> None:
            bar.update(task, total=total, completed=number - 1, description=phase)

        yield show


def _say(summary: "Summary", model: "Model", found: "Identified") -> None:
    from rich.console import Console
    from rich.table import Table

    good = len(summary.accepted)
    typer.echo(f"{len(summary.results)} cells, {good} good, {summary.resumed} from before")
    if summary.refused:
        typer.echo(f"note: a full send queue refused {summary.refused} set-points")
    for one in summary.results:
        if not one.accepted:
            typer.echo(f"  left out: {one.cell.name}: {'; '.join(one.problems)}")
    if found.friction is None:
        typer.echo(f"no friction identified: {found.problem}")
        return
    table = Table(title="friction (eq. 3) from the cells' means", title_justify="left", box=None)
    table.add_column("parameter")
    for heading in ("found", "95 % half width", "in the model file"):
        table.add_column(heading, justify="right")
    for name, width in found.half_widths.items():
        values = getattr(found.friction, name), width, getattr(model.friction, name)
        table.add_row(name, *(f"{value:.4g}" for value in values))
    Console(width=100, highlight=False).print(table)


def _say_whole(whole: "Whole") -> None:
    from rich.console import Console
    from rich.table import Table

    if whole.found is None:
        typer.echo(f"the logs identify nothing more: {whole.problem}")
        return
    table = Table(title="identified from the logs", title_justify="left", box=None)
    table.add_column("parameter")
    for heading in ("found", "95 % interval", "in the model file"):
        table.add_column(heading, justify="right")
    for name, one in whole.found.parameters.items():
        interval = one.status if one.ci95 is None else f"{one.ci95[0]:.4g} to {one.ci95[1]:.4g}"
        before = "" if one.from_model is None else f"{one.from_model:.4g}"
        table.add_row(name, f"{one.value:.4g}", interval, before)
    Console(width=100, highlight=False).print(table)
    for unknown in whole.found.cannot_tell:
        typer.echo(f"cannot tell: {unknown.what}: {unknown.why}")
    for finding in whole.found.findings:
        typer.echo(f"note: {finding.summary}")


def _write_model(path: Path, model: "Model", found: "Identified", whole: "Whole | None") -> None:
    """The whole identification where there is one, else the friction from the cells."""
    from dataclasses import replace

    from eps_hil.physics.model import dump_model
    from eps_hil.programme.summary import counted_twice
    from eps_hil.recordings.files import replacing

    if whole is not None and whole.text:
        text = whole.text
    elif found.friction is not None and (twice := counted_twice(model)):
        raise EpsHilError(f"{path}: not written, {twice}")
    elif found.friction is not None:
        text = dump_model(replace(model, friction=found.friction))
    else:
        raise EpsHilError(f"{path}: not written, {found.problem}")
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
