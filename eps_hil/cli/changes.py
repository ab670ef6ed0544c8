"""``eps-hil changes``: what differs between two states of one rig (CONTRACT 6)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from eps_hil.cli._files import check_kept, check_model_place, write_json
from eps_hil.cli._inputs import (
    ModelPath,
    Reading,
    progress,
    read_all,
    reads_recordings,
    same_file,
    stages,
)


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("changes")(reads_recordings(changes))


def changes(
    model: ModelPath,
    before: Annotated[
        list[Path], typer.Option("--before", help="Recordings of the first state, one or more.")
    ],
    after: Annotated[
        list[Path], typer.Option("--after", help="Recordings of the second state, one or more.")
    ],
    json: Annotated[Path | None, typer.Option("--json", help="The result as JSON.")] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="The second state as one HTML page, for people.")
    ] = None,
    write_model: Annotated[
        Path | None, typer.Option("--write-model", help="Model file of the second state.")
    ] = None,
    *,
    reading: Reading,
) -> None:
    """What does the rig do now that it did not do before?

    Both states are diagnosed, then one of them against all that was found in the other: friction,
    effects of the catalogue, and what has no name. Only what the other's recordings would have
    shown, and do not, is a change. Of each state the last recording, or the last third of a single
    one, is kept from the fit.
    """
    from eps_hil.diagnosis.changes import changes as run
    from eps_hil.diagnosis.data.intake import RecordingError
    from eps_hil.errors import InputError
    from eps_hil.physics.model import dump_model, load_model
    from eps_hil.recordings.files import replacing

    check_kept((json, report, write_model), (model, *before, *after))
    check_model_place(write_model)
    if report:
        from eps_hil.report import diagnosis_page, page

        page.check("--report", "uplot")
    rig = load_model(model)
    for path in before:
        if same_file(path, after):
            raise InputError(path, "", "is both --before and --after", "two states are compared")
    first, second = read_all(before, reading), read_all(after, reading)
    with stages("aligning the recordings") as say:
        try:
            found = run(rig, first, second, say)
        except RecordingError as error:
            raise InputError(error.recording, "", str(error)) from error
        except ValueError as error:
            raise InputError(", ".join([*first, *second]), "", str(error)) from error
    if write_model:  # written first: nobody may be there to read what is said
        with replacing(write_model) as temporary:
            temporary.write_text(dump_model(found.model), encoding="utf-8")
    if json:
        write_json(json, found.after.content)
    _say(found.after.content)
    if write_model:
        typer.echo(f"model of the second state written to {write_model}")
    if report:
        with progress("drawing the page"):
            diagnosis_page.write(found.after, report, str(model))
        typer.echo(f"page: {report}")


def _say(content: Mapping[str, Any]) -> None:
    from eps_hil.diagnosis.changes import in_words, what_would_show
    from eps_hil.physics.effects.catalogue import catalogue

    known = [_named(one["effect"], catalogue()) for one in content["before"]["findings"]]
    if known:
        typer.echo(f"Beyond the model file, the first state has {', '.join(known)}.")
    if content["findings"]:
        typer.echo("What has changed:")
    elif content["undecided"]:
        typer.echo("Not decided whether anything has changed; what stands against it is below.")
    else:
        typer.echo(f"Nothing has changed that {what_would_show(content)}.")
    for one in content["findings"]:
        typer.echo(f"  {_named(one['effect'], catalogue())} ({100 * one['confidence']:.0f} %), "
                   f"{in_words(one['change'])}: {one['summary']}")  # fmt: skip
        if one["confusable_with"]:
            typer.echo(f"    could also be {', '.join(one['confusable_with'])}; "
                       f"{one['next_experiment']}")  # fmt: skip
    for limit in content["limits"]:
        typer.echo(f"  note: {limit}")
    if not content["findings"]:
        return
    holdout = content["fit"]["holdout"]
    units = {"torque_nrmse": "", "speed_fit_percent": " %", "rack_force_rmse_n": " N"}
    for name, unit in units.items():
        if all(holdout[one].get(name) is not None for one in ("baseline", "augmented")):
            before, after = (holdout[one][name] for one in ("baseline", "augmented"))
            typer.echo(f"  second state's hold-outs, {name}: {before:.4g}{unit} as before, "
                       f"{after:.4g}{unit} with the changes")  # fmt: skip
    floor = holdout["noise_floor"]["torque_nrmse"]
    typer.echo(f"  sensor noise alone: torque_nrmse {floor:.4g}")


def _named(effect: str, known: Mapping[str, Any]) -> str:
    return f"{known[effect].name} [{effect}]" if effect in known else effect
