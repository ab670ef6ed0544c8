"""``eps-hil simulate``: a recording's inputs through the model (CONTRACT 6)."""

from pathlib import Path
from typing import Annotated

import typer

from eps_hil.cli._files import check_kept
from eps_hil.cli._first_answer import say_if_it_compiles
from eps_hil.cli._inputs import (
    ModelPath,
    Reading,
    read_recording,
    reads_recordings,
    waiting,
)


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("simulate")(reads_recordings(simulate))


def simulate(
    model: ModelPath,
    inputs: Annotated[Path, typer.Option("--inputs", help="Recording with torques and force.")],
    out: Annotated[Path, typer.Option("--out", help="Simulated signals (.csv, .parquet, .mf4).")],
    physical: Annotated[
        bool,
        typer.Option("--physical", help="Write physical instants, not what sensors report late."),
    ] = False,
    *,
    reading: Reading,
) -> None:
    """Run the recorded motor torque, torsion-bar torque and rack force through the model.

    The output is a recording like the input: canonical columns at its stamps, each as late as the
    model file says its sensor is, so that the two lie on top of each other if the model is right.
    """
    import eps_hil
    from eps_hil.physics.model import load_model
    from eps_hil.recordings.write import check_writable_suffix

    rig = load_model(model)
    check_writable_suffix(out)
    check_kept((out,), (model, inputs, *reading.files()))
    recording = read_recording(inputs, reading)
    read = eps_hil.Recording(str(inputs), recording.series, recording.notes)
    say_if_it_compiles()
    with waiting("simulating"):
        made = eps_hil.simulate(read, rig, physical=physical)
    for note in made.notes:
        typer.echo(f"{inputs.name}: {note}", err=True)
    made.save(out)
    typer.echo(f"{inputs.name}: {len(made.t_ns)} rows simulated to {out}")
