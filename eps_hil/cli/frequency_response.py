"""``eps-hil frequency-response REC…``: measured responses to the motor torque, and the models'."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eps_hil.cli._first_answer import say_if_it_compiles
from eps_hil.cli._inputs import (
    Gaps,
    ModelPath,
    Reading,
    RecordingPaths,
    check_once,
    progress,
    read_each,
    reads_recordings,
    told_what_it_holds,
)

if TYPE_CHECKING:
    from eps_hil.identification.chain_response import Agreement, Load
    from eps_hil.identification.frequency_response import Response, ResponseSettings, Stretch
    from eps_hil.physics.model import Model

SCHEMA = "eps-hil/frequency-response/1"


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("frequency-response")(reads_recordings(frequency_response, Gaps.MARK))


def frequency_response(
    recordings: RecordingPaths,
    model: ModelPath,
    chain: Annotated[
        Path | None,
        typer.Option("--chain", help="Masses and springs (YAML): adds the 1- to 5-mass models."),
    ] = None,
    masses: Annotated[
        list[int] | None,
        typer.Option("--masses", min=1, max=5, help="Models of so many masses only; may repeat."),
    ] = None,
    load_stiffness: Annotated[
        float | None,
        typer.Option("--load-stiffness", min=0, help="Of the linear motor, N/m; else fitted."),
    ] = None,
    load_damping: Annotated[
        float | None,
        typer.Option("--load-damping", min=0, help="Of the linear motor, Ns/m; else fitted."),
    ] = None,
    from_hz: Annotated[float, typer.Option("--from-hz", min=0.01, help="Lowest frequency.")] = 0.5,
    to_hz: Annotated[float, typer.Option("--to-hz", max=499, help="Highest frequency.")] = 8.0,
    resolution_hz: Annotated[
        float, typer.Option("--resolution-hz", min=0.01, max=5, help="One over a window's length.")
    ] = 0.25,
    estimator: Annotated[
        str, typer.Option("--estimator", help="h1 (output noise), h2 (input noise) or hv (both).")
    ] = "h1",
    out: Annotated[Path | None, typer.Option("--out", help="Picture (.png, .svg, .pdf).")] = None,
    json: Annotated[Path | None, typer.Option("--json", help="All lines as JSON.")] = None,
    *,
    reading: Reading,
) -> None:
    """Frequency responses of speed, position, wheel speed and force to the motor torque.

    Several recordings are averaged. With --chain the recorded torque is run through the 1- to
    5-mass models, friction included, and their responses are compared with the measured ones.
    """
    from eps_hil.cli._files import check_kept, write_json
    from eps_hil.errors import InputError
    from eps_hil.identification.frequency_response import (
        ESTIMATORS,
        BandError,
        ResponseSettings,
        responses,
    )
    from eps_hil.physics.model import load_model
    from eps_hil.report import figures

    if out:
        figures.check(out)
    check_kept((json,), (model, chain, *recordings, *reading.files()))
    if estimator not in ESTIMATORS:
        raise InputError("--estimator", estimator, "is none", f"use {', '.join(ESTIMATORS)}")
    if (load_stiffness is None) != (load_damping is None):
        raise InputError("--load-stiffness", "", "goes with --load-damping", "give both or none")
    settings = ResponseSettings(from_hz, to_hz, resolution_hz, estimator)  # type: ignore[arg-type]
    rig = load_model(model)
    parts = _stretches(recordings, rig, reading)
    try:
        measured = responses(parts, settings)
    except BandError as error:
        remedy = "widen it (--from-hz, --to-hz), or lower --resolution-hz"
        raise InputError("--from-hz", "", str(error), remedy) from error
    except ValueError as error:
        remedy = "record longer without gaps, or raise --resolution-hz"
        raise InputError(recordings[0], "", str(error), remedy) from error
    load: Load | None = None
    models: dict[int, dict[str, Response]] = {}
    found: list[Agreement] = []
    if chain:
        given = None if load_stiffness is None else (load_stiffness, load_damping)
        load = _load(parts, given, recordings[0])
        models, found = _models(parts, rig, chain, load, settings, masses, measured)
    _say(measured, found, load)
    if json:
        write_json(json, _content(recordings, settings, measured, models, found, load))
    if out:
        from eps_hil.report import frequency_figure

        typer.echo(f"figure: {frequency_figure.draw(measured, models, out)}")


def _stretches(paths: list[Path], rig: "Model", reading: Reading) -> "list[Stretch]":
    from eps_hil.identification.frequency_response import stretches

    check_once(paths)
    parts: list[Stretch] = []
    for path, recording in read_each(paths, reading):
        with told_what_it_holds(path, recording):
            parts += stretches(recording.series, rig)
    return parts


def _load(parts: "list[Stretch]", given: tuple[float, float | None] | None, path: Path) -> "Load":
    from eps_hil.errors import InputError
    from eps_hil.identification.chain_response import Load, fitted_load

    if given is not None:
        return Load(given[0], given[1] or 0.0)
    try:
        return fitted_load(parts)
    except ValueError as error:
        remedy = "give --load-stiffness and --load-damping"
        raise InputError(path, "rack_force_n", str(error), remedy) from error


def _models(
    parts: "list[Stretch]",
    rig: "Model",
    chain: Path,
    load: "Load",
    settings: "ResponseSettings",
    masses: list[int] | None,
    measured: "Mapping[str, Response]",
) -> "tuple[dict[int, dict[str, Response]], list[Agreement]]":
    from eps_hil.identification.chain_response import ORDERS, agreement, chain_responses
    from eps_hil.physics.chain_parameters import load_chain

    parameters = load_chain(chain)
    models: dict[int, dict[str, Response]] = {}
    orders = sorted(set(masses)) if masses else ORDERS
    say_if_it_compiles()
    with progress("running the models") as bar:
        for number, order in enumerate(orders):
            models |= chain_responses(parts, rig, parameters, load, settings, (order,))
            if bar:
                bar((number + 1) / len(orders))
    pairs = [(order, name) for order in orders for name in measured]
    return models, [agreement(measured[name], models[k][name], k) for k, name in pairs]


def _say(measured: "Mapping[str, Response]", found: "list[Agreement]", load: "Load | None") -> None:
    from rich.console import Console
    from rich.table import Table

    from eps_hil.identification.frequency_response import OUTPUTS

    console = Console(width=100, highlight=False)
    table = Table(title="responses to the motor torque", title_justify="left", box=None)
    for heading in ("output", "lines", "trusted", "least coherence", "averages"):
        table.add_column(heading, justify="left" if heading == "output" else "right")
    for name, one in measured.items():
        counts = (str(len(one.gain)), str(int(one.trusted.sum())))
        worst = f"{one.coherence.min():.3f}"
        table.add_row(OUTPUTS[name], *counts, worst, f"{one.averages:.1f}")
    console.print(table)
    if load is None:
        return
    typer.echo(
        f"load: {load.stiffness_n_per_m:.4g} N/m, {load.damping_n_s_per_m:.4g} Ns/m "
        f"about {1e3 * load.position_m:.3g} mm"
    )
    table = Table(title="models against the measurement, rms", title_justify="left", box=None)
    table.add_column("masses")
    table.add_column("output")
    for heading in ("relative", "dB", "degrees", "inside 95 %"):
        table.add_column(heading, justify="right")
    for each in found:
        numbers = f"{each.gain_error:.3f}", f"{each.magnitude_error_db:.2f}"
        more = f"{each.phase_error_deg:.1f}", f"{100 * each.inside:.0f} %"
        table.add_row(str(each.order), OUTPUTS[each.output], *numbers, *more)
    console.print(table)


def _content(
    recordings: list[Path],
    settings: "ResponseSettings",
    measured: "Mapping[str, Response]",
    models: "Mapping[int, Mapping[str, Response]]",
    found: "list[Agreement]",
    load: "Load | None",
) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "schema": SCHEMA,
        "recordings": [str(path) for path in recordings],
        "settings": asdict(settings),
        "load": asdict(load) if load else None,
        "measured": {name: _lines(one) for name, one in measured.items()},
        "models": {
            str(order): {name: _lines(one) for name, one in each.items()}
            for order, each in models.items()
        },
        "agreement": [asdict(each) for each in found],
    }


def _lines(one: "Response") -> dict[str, Any]:
    return {
        "frequency_hz": one.frequency_hz.tolist(),
        "gain_real": one.gain.real.tolist(),
        "gain_imag": one.gain.imag.tolist(),
        "coherence": one.coherence.tolist(),
        "radius95": one.radius.tolist(),
        "trusted": one.trusted.tolist(),
        "averages": one.averages,
    }
