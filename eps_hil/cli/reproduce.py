"""``eps-hil reproduce``: the seed paper's figures and table, made anew and judged."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eps_hil.cli._first_answer import say_if_it_compiles

if TYPE_CHECKING:
    from eps_hil.reproduction.reproduce import Reproduction


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("reproduce")(reproduce)


def reproduce(
    out: Annotated[
        Path, typer.Option("--out", help="Folder for index.html and the figures (made if absent).")
    ] = Path("reproduction"),
    quick: Annotated[
        bool, typer.Option("--quick", help="Shorter manoeuvres and fewer cells: a first look.")
    ] = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the sensor noise.")] = 0,
    json: Annotated[Path | None, typer.Option("--json", help="All numbers as JSON.")] = None,
) -> None:
    """Make figs 4, 5, 7, 9 to 12, 14 and table 2 of the seed paper on the simulated rig.

    Every statement of the paper is judged by a number and its limits: agrees, partly, or does not
    agree. The same seed gives the same numbers.
    """
    from eps_hil.cli._files import check_kept, write_json
    from eps_hil.cli._inputs import progress
    from eps_hil.recordings.files import make_folder
    from eps_hil.report.page import check
    from eps_hil.reproduction import page
    from eps_hil.reproduction.reproduce import reproduce as run

    check("reproduce", "matplotlib")
    make_folder(out, "--out")
    check_kept((json,), ())
    say_if_it_compiles()
    with progress("reproducing the paper") as bar:
        step = (lambda _name, part: bar(part)) if bar else None
        made = run(out, seed=seed, quick=quick, on_progress=step)
    page.write(made, out / "index.html")
    _say(made)
    if json:
        write_json(json, made.content())
    typer.echo(f"page: {out / 'index.html'}")


def _say(made: "Reproduction") -> None:
    from rich.console import Console
    from rich.table import Table

    from eps_hil.reproduction.result import Outcome

    table = Table(title="the paper's statements", title_justify="left", box=None)
    for heading in ("where", "the paper says", "here", "by"):
        table.add_column(heading)
    for result in made.results:
        for one in result.statements:
            table.add_row(result.key, one.claim, one.outcome.value, one.sentence)
    Console(width=160, highlight=False).print(table)
    counts = ", ".join(f"{made.count(outcome)} {outcome.value}" for outcome in Outcome)
    typer.echo(f"{counts}; {len(made.results)} figures and tables in {made.seconds:.0f} s")
