"""``eps-hil tune``: the observer's noise against its delay, with the present setting marked."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eps_hil.cli._files import check_kept, write_json
from eps_hil.cli._first_answer import say_if_it_compiles
from eps_hil.cli._inputs import ModelPath, Reading, progress, read_recording, reads_recordings

if TYPE_CHECKING:
    from eps_hil.estimation.tuning import Noise, Point
    from eps_hil.physics.model import Model
    from eps_hil.recordings.recording import Recording

_CHECKED = 5


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("tune")(reads_recordings(tune))


def tune(
    model: ModelPath,
    recording: Annotated[
        Path | None,
        typer.Option("--recording", help="Take the noise from the rests of this recording."),
    ] = None,
    settings: Annotated[
        Path | None, typer.Option("--settings", help="Estimator settings (YAML).")
    ] = None,
    signal_hz: Annotated[
        float, typer.Option("--signal-hz", min=0.1, help="Fastest rack force of interest.")
    ] = 4.0,
    json: Annotated[Path | None, typer.Option("--json", help="The curve as JSON.")] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="The curve (.png, .svg, .pdf).")
    ] = None,
    *,
    reading: Reading,
) -> None:
    """Show what a faster or slower observer costs: newtons of noise against milliseconds of delay.

    Worked out from the observer's covariance and checked by running the estimator over the same
    noise. Without --recording the noise of the settings is used.
    """
    from eps_hil import yaml_file
    from eps_hil.errors import InputError
    from eps_hil.estimation import tuning
    from eps_hil.estimation.settings import EstimatorSettings
    from eps_hil.physics.effects.catalogue import with_model_effects
    from eps_hil.physics.model import load_model
    from eps_hil.report import figures

    if figure:
        figures.check(figure)
    check_kept((json,), (model, recording, settings, *reading.files()))
    rig = with_model_effects(load_model(model))
    chosen = yaml_file.load(settings, EstimatorSettings) if settings else EstimatorSettings()
    if chosen.quantity == "friction":
        raise InputError(settings or "", "quantity", "the curve is that of the rack force",
                         "leave it at rack_force")  # fmt: skip
    noise = tuning.assumed_noise(chosen)
    if recording is not None:
        noise = _noise_of(read_recording(recording, reading), recording, rig)
    now, points = tuning.point(rig, chosen, noise), tuning.curve(rig, chosen, noise)
    places = [round(k * (len(points) - 1) / (_CHECKED - 1)) for k in range(_CHECKED)]
    checked: list[tuple[Point, float]] = []
    say_if_it_compiles()
    with progress("checking by simulation") as bar:
        for done, place in enumerate(places):
            one = points[place]
            there = tuning.with_walk(chosen, one.force_walk_n_per_sqrt_s)
            checked.append((one, tuning.simulated_noise_n(rig, there, noise)))
            if bar is not None:
                bar((done + 1) / (len(places) + 1))
        now_simulated = tuning.simulated_noise_n(rig, chosen, noise)
    said = tuning.advise(now, points, signal_hz)
    _say(points, dict(zip(places, checked, strict=True)), now, now_simulated, noise)
    for sentence in said:
        typer.echo(sentence)
    if json:
        write_json(
            json,
            {
                "schema": "eps-hil/tune/1",
                "model": str(model),
                "noise": {
                    "speed_rad_s": noise.speed_rad_s,
                    "torque_nm": noise.torque_nm,
                    "from": noise.origin,
                },
                "now": _plain(now) | {"simulated_noise_n": now_simulated},
                "curve": [_plain(one) for one in points],
                "simulated": [
                    {"force_walk_n_per_sqrt_s": one.force_walk_n_per_sqrt_s, "noise_n": found}
                    for one, found in checked
                ],
                "advice": said,
            },
        )
    if figure:
        from eps_hil.report.tuning_figure import draw

        typer.echo(f"figure: {draw(points, now, checked, noise.origin, figure)}")


def _noise_of(read: "Recording", path: Path, rig: "Model") -> "Noise":
    from eps_hil.errors import InputError
    from eps_hil.estimation.tuning import dwell_noise

    found = dwell_noise(read.series, rig)
    if found is None:
        raise InputError(
            path, "", "holds no rest of 0.4 s with motor speed and torque to take noise from",
            "record a dwell, or leave --recording out",
        )  # fmt: skip
    if found.speed_rad_s <= 0.0 and found.torque_nm <= 0.0:
        raise InputError(path, "", "its rests hold no noise at all (a resolution coarser than the "
                         "noise hides it)", "leave --recording out")  # fmt: skip
    return found


def _plain(one: "Point") -> dict[str, Any]:
    return {
        "force_walk_n_per_sqrt_s": one.force_walk_n_per_sqrt_s,
        "noise_n": one.noise_n,
        "from_speed_n": one.speed_share_n,
        "from_torque_n": one.torque_share_n,
        "delay_s": one.delay_s,
        "bandwidth_hz": one.bandwidth_hz if math.isfinite(one.bandwidth_hz) else None,
    }


def _say(
    points: "list[Point]",
    checked: "dict[int, tuple[Point, float]]",
    now: "Point",
    now_simulated: float,
    noise: "Noise",
) -> None:
    from rich.console import Console
    from rich.table import Table

    typer.echo(
        f"noise from {noise.origin}: speed {noise.speed_rad_s:.3g} rad/s rms, "
        f"torque {1e3 * noise.torque_nm:.3g} mNm rms at the rotor"
    )
    table = Table(title="bandwidth against noise", title_justify="left", box=None)
    for heading in ("force walk N/√s", "noise N rms", "by simulation", "delay ms", "−3 dB at Hz"):
        table.add_column(heading, justify="right")
    rows = [(one, checked.get(k, (one, math.nan))[1], "") for k, one in enumerate(points)]
    rows = [row for k, row in enumerate(rows) if k % 3 == 0 or k in checked]
    rows.append((now, now_simulated, " now"))
    for one, found, mark in sorted(rows, key=lambda row: row[0].force_walk_n_per_sqrt_s):
        table.add_row(
            f"{one.force_walk_n_per_sqrt_s:g}{mark}",
            f"{one.noise_n:.2f}",
            "" if math.isnan(found) else f"{found:.2f}",
            f"{1e3 * one.delay_s:.1f}",
            f"{one.bandwidth_hz:.0f}",
        )
    Console(width=100, highlight=False).print(table)
