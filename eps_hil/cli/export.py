"""``eps-hil export``: the model in a form that other tools run."""

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("export")(export)


def export(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="Model file (YAML).")],
    fmu: Annotated[Path, typer.Option("--fmu", metavar="OUT.fmu", help="Co-simulation, in C.")],
    fmi_version: Annotated[
        int, typer.Option("--fmi-version", metavar="2|3", help="Of the FMU.")
    ] = 2,
) -> None:
    """Write the model, its effects included, as an FMU that runs without Python.

    Inputs are motor torque, torsion-bar torque and rack force; every number of the model is a
    parameter. Needs a C compiler here, and none where the FMU runs.
    """
    from eps_hil.cli._files import check_kept
    from eps_hil.fmu.export import export_fmu
    from eps_hil.physics.model import load_model

    rig = load_model(model)
    check_kept((fmu,), (model,))
    made = export_fmu(rig, fmu, model, fmi_version)
    for note in made.notes:
        typer.echo(f"{model.name}: {note}", err=True)
    count = sum(one.causality == "parameter" for one in made.variables)
    effects = len(rig.effects)
    typer.echo(
        f"{fmu}: FMI {fmi_version}.0 co-simulation with {count} parameters, "
        f"{effects} effect{'' if effects == 1 else 's'}, for {', '.join(made.platforms)}"
    )
