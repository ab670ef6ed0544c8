"""``eps-hil simulate``: a recording's inputs through the model (CONTRACT 6)."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eps_hil.cli._files import check_different, check_places
from eps_hil.cli._inputs import (
    ModelPath,
    Reading,
    read_recording,
    reads_recordings,
    told_what_it_holds,
)

if TYPE_CHECKING:
    from eps_hil.physics.model import Model
    from eps_hil.recordings.recording import Recording


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
    from eps_hil.physics.model import load_model
    from eps_hil.recordings.write import check_writable_suffix, write_table

    rig = load_model(model)
    check_writable_suffix(out)
    check_places(out)
    check_different(out, inputs)
    recording = read_recording(inputs, reading)
    t_ns, columns = _run(inputs, recording, rig, physical)
    write_table(out, columns, t_ns=t_ns)
    typer.echo(f"{inputs.name}: {len(t_ns)} rows simulated to {out}")


def _run(path: Path, recording: "Recording", rig: "Model", physical: bool) -> Any:
    from eps_hil.physics.forward import InputMissingError, forward

    with told_what_it_holds(path, recording, InputMissingError):
        result = forward(rig, recording.series, physical=physical)
    for note in result.notes:
        typer.echo(f"{path.name}: {note}", err=True)
    return result.t_ns, result.columns
