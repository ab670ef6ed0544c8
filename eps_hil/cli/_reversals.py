"""``eps-hil calibrate reversals``: friction levels from recordings of ordinary driving."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eps_hil.cli._first_answer import say_if_it_compiles
from eps_hil.cli._inputs import (
    ModelPath,
    Reading,
    RecordingPaths,
    progress,
    read_each,
    told_what_it_holds,
)

if TYPE_CHECKING:
    from eps_hil.adaptation.reversal import ReversalState


def reversals(
    recordings: RecordingPaths,
    model: ModelPath,
    json: Annotated[Path | None, typer.Option("--json", help="Levels as JSON.")] = None,
    without_load_cell: Annotated[
        bool, typer.Option("--without-load-cell", help="Leave rack_force_n aside.")
    ] = False,
    *,
    reading: Reading,
) -> None:
    """Friction levels from every change of direction in recordings, at any rack force.

    Without a load cell only the sum of both levels shows. Nothing is applied or written but --json.
    """
    from eps_hil.adaptation.offline import adapt
    from eps_hil.adaptation.reversal import ReversalAdaptation, ReversalSettings
    from eps_hil.cli._files import check_kept, write_json
    from eps_hil.physics.model import load_model

    check_kept((json,), (model, *recordings))
    rig = load_model(model)
    say_if_it_compiles()
    adaptation = ReversalAdaptation(ReversalSettings(load_cell=not without_load_cell), rig)
    for path, recording in read_each(recordings, reading):
        with progress(f"adapting to {path.name}") as bar, told_what_it_holds(path, recording):
            states = adapt(recording.series, rig, adaptation, bar)
        typer.echo(f"{path.name}: {len(states)} stretches of 6 s")
    for line in _words(adaptation.state):
        typer.echo(line)
    if json:
        write_json(json, _content(adaptation.state))


def _words(state: "ReversalState") -> list[str]:
    lines = [
        f"reversals  {state.used} counted; {state.left_out} stretches left out (no reversal, or the"
        " road moved the rack)",
        f"sum        k0+ + k0- = {state.sum_nm:.4f} Nm, standard deviation {state.sum_std_nm:.4f}"
        + ("" if state.confident else ": not sure yet"),
    ]
    if state.asymmetry_known:
        forth, back = state.levels
        lines.append(f"levels     k0+ {forth:.4f} Nm, k0- {back:.4f} Nm")
    else:
        lines.append(
            "levels     k0+ and k0- apart were not seen: that needs a load cell, or no rack force"
            " (eps-hil calibrate torque-injection)"
        )
    if state.flag:
        lines.append(f"note       {state.flag}")
    return lines


def _content(state: "ReversalState") -> dict[str, Any]:
    return {
        "schema": "eps-hil/reversals/1",
        "sum_nm": state.sum_nm,
        "sum_std_nm": state.sum_std_nm,
        "offset_pos_nm": state.levels.positive_nm if state.asymmetry_known else None,
        "offset_neg_nm": state.levels.negative_nm if state.asymmetry_known else None,
        "confident": state.confident,
        "reversals": state.used,
        "stretches_left_out": state.left_out,
        "flag": state.flag,
    }
