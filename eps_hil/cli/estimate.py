"""``eps-hil estimate REC…``: the rack force of recordings (CONTRACT 6)."""

import enum
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eps_hil.cli._files import (
    check_kept,
    output_for,
    outputs_for,
    write_json,
)
from eps_hil.cli._inputs import (
    ModelPath,
    Reading,
    RecordingPaths,
    read_each,
    reads_recordings,
    waiting,
)

if TYPE_CHECKING:
    from eps_hil import Estimate
    from eps_hil.estimation.levels import LevelChange
    from eps_hil.estimation.settings import EstimatorSettings


class Block(enum.StrEnum):
    """A block of the estimator (PAPER fig. 8) that can be switched off."""

    FRICTION_COMPENSATION = "friction-compensation"
    EXTENSIONS = "extensions"
    DEAD_ZONE = "dead-zone"
    LIMITER = "limiter"
    LOW_PASS = "low-pass"


class Kind(enum.StrEnum):
    """An estimator (docs/theory-second-estimator.md)."""

    OBSERVER = "observer"
    BRISTLE_FILTER = "bristle_filter"
    SMOOTHER = "smoother"


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("estimate")(reads_recordings(estimate))


def estimate(
    recordings: RecordingPaths,
    model: ModelPath,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Estimates (.csv, .parquet, .mf4); {name} = recording."),
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", help="Summary as JSON.")] = None,
    settings: Annotated[
        Path | None, typer.Option("--settings", help="Estimator settings (YAML).")
    ] = None,
    without: Annotated[
        list[Block] | None, typer.Option("--without", help="Switch a block off; may repeat.")
    ] = None,
    kind: Annotated[
        Kind | None,
        typer.Option("--estimator", help="The paper's observer, or one with the bristle inside."),
    ] = None,
    friction: Annotated[
        bool,
        typer.Option("--friction", help="Rack force known: give the friction torque instead."),
    ] = False,
    friction_journal: Annotated[
        Path | None,
        typer.Option("--friction-journal", help="Take over friction levels as the service did."),
    ] = None,
    *,
    reading: Reading,
) -> None:
    """Estimate the rack force of recordings.

    --out holds time_s, rack_force_estimate_n, friction_torque_nm, valid; time_s is the physical
    instant that a row speaks of. Where a recording has rack_force_n, the error is shown too.
    """
    import eps_hil
    from eps_hil.cli import _first_answer
    from eps_hil.physics.model import load_model

    targets = _targets(out, recordings) if out else []
    given = (model, settings, friction_journal, *recordings, *reading.files())
    check_kept([json, *targets], given)
    rig = load_model(model)
    chosen = _settings(settings, without or [], friction, kind)
    changes = _changes(friction_journal)
    results: list[Any] = []
    for path, recording in read_each(recordings, reading):
        if not results and chosen.kind == "observer":
            _first_answer.prepare(recording.series, len(recordings), effects=bool(rig.effects))
        _first_answer.say_if_it_compiles()
        arrived, pace = recording.arrivals, recording.pace
        read = eps_hil.Recording(str(path), recording.series, recording.notes, arrived, pace)
        with waiting(f"estimating {path.name}"):
            found = eps_hil.estimate(read, rig, chosen, changes=changes)
        _say(path.name, found)
        results.append(found.content)
        if out:
            target = found.save(output_for(out, path, len(recordings) > 1))
            typer.echo(f"{path.name}: {len(found.trace.t_ns)} rows written to {target}")
    if json:
        write_json(
            json,
            {"schema": "eps-hil/estimate/1", "model": str(model), "recordings": results},
        )


def _changes(journal: Path | None) -> "list[LevelChange]":
    if journal is None:
        return []
    from eps_hil.service.journal import level_changes

    return level_changes(journal)


def _settings(
    path: Path | None, without: list[Block], friction: bool, kind: Kind | None
) -> "EstimatorSettings":
    from dataclasses import replace

    from eps_hil import yaml_file
    from eps_hil.estimation.settings import EstimatorSettings

    chosen = yaml_file.load(path, EstimatorSettings) if path else EstimatorSettings()
    names = {block.value.replace("-", "_") for block in without}
    if "extensions" in names:
        names = (names - {"extensions"}) | {"dead_zone", "limiter"}
    changes: dict[str, Any] = dict.fromkeys(names, False)
    if friction:
        changes["quantity"] = "friction"
    if kind is not None:
        changes["kind"] = kind.value
    return replace(chosen, **changes)


def _targets(out: Path, recordings: list[Path]) -> list[Path]:
    """Where the estimates go; refused where they cannot."""
    from eps_hil.recordings.write import check_writable_suffix

    targets = outputs_for(out, recordings)
    for target in targets.values():
        check_writable_suffix(target)
    return list(targets.values())


def _say(name: str, found: "Estimate") -> None:
    from eps_hil.recordings.coverage import in_words

    typer.echo(
        f"{name}: {len(found.trace.t_ns)} estimates, {100 * found.trace.valid.mean():.2f} % valid, "
        + (
            "smoothed afterwards"
            if math.isnan(found.latency_s)
            else f"latency {1e3 * found.latency_s:.1f} ms"
        )
    )
    if why := found.why_not_valid:
        typer.echo(f"{name}: not valid: {why}")
    for gap in in_words(found.gaps):
        typer.echo(f"{name}: {gap}", err=True)
    if "torque_sensor_nm" not in found.recording.series:
        typer.echo(
            f"{name}: no torsion-bar torque: what the driver holds counts as rack force", err=True
        )
    if not (error := found.score):
        return
    if math.isnan(error.rmse_overall_n):
        typer.echo(f"{name}: no estimate is valid: nothing to compare with the load cell")
        return
    moving = "" if math.isnan(error.rmse_moving_n) else f"{error.rmse_moving_n:.1f} N rms moving, "
    typer.echo(
        f"{name}: error against the load cell: {moving}"
        f"{error.rmse_overall_n:.1f} N rms overall, of {error.rms_force_n:.0f} N rms"
    )
