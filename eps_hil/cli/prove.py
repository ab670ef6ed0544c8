"""``eps-hil prove``: the proofs that anybody can run again (CONTRACT 6)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from eps_hil.cli._files import write_json
from eps_hil.cli._inputs import progress


def register(app: typer.Typer) -> None:
    """Add the verb and its proofs."""
    group = typer.Typer(no_args_is_help=True, help="Run a proof of the diagnosis again.")
    group.command("emps")(emps)
    app.add_typer(group, name="prove")


def emps(
    data_dir: Annotated[
        Path,
        typer.Argument(
            metavar="DATA_DIR", help="Folder with DATA_EMPS.mat and DATA_EMPS_PULSES.mat."
        ),
    ],
    json: Annotated[Path | None, typer.Option("--json", help="The result as JSON.")] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Before and after (.png, .svg, .pdf).")
    ] = None,
) -> None:
    """Real hardware, a ball-screw axis: find what its published model lacks, judge it on new data.

    Everything is fitted on DATA_EMPS. In DATA_EMPS_PULSES a square wave of force is withheld, is
    estimated as the rack force is, and is opened at the end.
    """
    from eps_hil.axis.emps import read
    from eps_hil.axis.proof import prove

    fitted, heldout = read(data_dir)
    with progress("proving") as bar:
        proof = prove(fitted, heldout, (lambda _what, part: bar(part)) if bar else None)
    _say(proof.content)
    if json:
        write_json(json, proof.content)
    if figure:
        from eps_hil.axis.figure import draw

        typer.echo(f"figure written to {draw(proof, figure)}")


_ROWS = (
    ("heldout_force_error_percent", "held-out force error, %"),
    ("hidden_force_rmse_n", "hidden force, RMSE in N"),
    ("hidden_force_without_drive_delay_rmse_n", "  if it is taken not to be late, N"),
    ("hidden_force_plateau_rmse_n", "  between its edges, N"),
    ("online_hidden_force_rmse_n", "on-line estimator, RMSE in N"),
    ("online_hidden_force_plateau_rmse_n", "  between its edges, N"),
)


def _say(content: Mapping[str, Any]) -> None:
    typer.echo(
        f"On DATA_EMPS_PULSES, of which nothing was fitted, below {content['band_hz']:g} Hz:"
    )
    typer.echo(f"  {'':34}{'published':>11}{'identified':>12}{'augmented':>11}")
    for name, words in _ROWS:
        row = content[name]
        typer.echo(
            f"  {words:34}{row['before']:11.2f}{row['identified_only']:12.2f}{row['after']:11.2f}"
        )
    numbers = content["parameters"]
    typer.echo("The model's own numbers, from DATA_EMPS:")
    for name in numbers["published"]:
        typer.echo(
            f"  {name:34}{numbers['published'][name]:11.5g}{numbers['identified'][name]:12.5g}"
            f"{numbers['augmented'][name]:11.5g}"
        )
    typer.echo("What that structure lacks, and the two figures without it:")
    for finding in content["findings"]:
        without = finding["heldout_without_it"]
        typer.echo(
            f"  {finding['effect']}: {finding['summary']} "
            f"({without['heldout_force_error_percent']:.2f} %, "
            f"{without['hidden_force_rmse_n']:.2f} N)"
        )
