"""``eps-hil identify``: a rig's model from its recordings (CONTRACT 6)."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eps_hil.cli._files import check_kept, check_model_place, write_json
from eps_hil.cli._first_answer import say_if_it_compiles
from eps_hil.cli._inputs import (
    ModelPath,
    Reading,
    RecordingPaths,
    progress,
    read_all,
    reads_recordings,
    same_file,
    say_notes,
)
from eps_hil.errors import InputError
from eps_hil.unit_words import of, spaced

if TYPE_CHECKING:
    from eps_hil.identification.result import Estimate, Identification


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("identify")(reads_recordings(identify))


def identify(
    recordings: RecordingPaths,
    model: ModelPath,
    write_model: Annotated[
        Path | None, typer.Option("--write-model", help="Model file with what was identified.")
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", help="The result as JSON.")] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="The result as one HTML page, for people.")
    ] = None,
    simulation: Annotated[
        Path | None,
        typer.Option(
            "--simulation",
            metavar="MODEL.fmu",
            help="Fit your own simulator's parameters (--free) and not the model's.",
        ),
    ] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(
            "--free",
            metavar="NAME",
            help="With --simulation: a parameter to fit; NAME=low:high: between these.",
        ),
    ] = None,
    simulation_signals: Annotated[
        Path | None,
        typer.Option(
            "--simulation-signals", help="Mapping (YAML) of the FMU's variables to our names."
        ),
    ] = None,
    simulation_values: Annotated[
        Path | None,
        typer.Option(
            "--simulation-values", help="Other parameters and switches of the FMU (YAML or JSON)."
        ),
    ] = None,
    holdout: Annotated[
        list[Path] | None,
        typer.Option("--holdout", help="With --simulation: recordings kept from the fit."),
    ] = None,
    *,
    reading: Reading,
) -> None:
    """Delays, inertia, friction map and bristle parameters from rig recordings, with intervals.

    The model file gives the ratios, starting values, and whatever the recordings cannot tell.
    Needs motor torque, and rotor speed or angle; the load cell where the load is not a free rack
    or a spring.
    """
    import eps_hil
    from eps_hil.identification.write_model import model_file
    from eps_hil.physics.model import load_model
    from eps_hil.recordings.files import replacing

    if simulation:
        if write_model or report:
            name = "--write-model" if write_model else "--report"
            problem, remedy = "does not go with --simulation", "its numbers are in --json"
            raise InputError(name, "", problem, remedy)
        files = simulation_signals, simulation_values
        _simulator(recordings, model, simulation, free, files, holdout, json, reading)
        return
    if free or simulation_signals or simulation_values or holdout:
        raise InputError("--free", "", "goes with --simulation, as --holdout does", "give the FMU")
    if report:
        from eps_hil.report import identification_page, page

        page.check("--report", "matplotlib")
    check_kept((write_model, json, report), (model, *recordings, *reading.files()))
    check_model_place(write_model)
    rig = load_model(model)
    read = read_all(recordings, reading)
    given = [eps_hil.Recording(name, series) for name, series in read.items()]
    say_if_it_compiles()
    with progress("identifying") as bar:
        found = eps_hil.identify(given, rig, on_progress=bar).result
    if json:  # written first: nobody may be there to read what is said
        write_json(json, found.content())
    if write_model:
        with replacing(write_model) as temporary:
            text = model_file(found, str(model), [str(path) for path in recordings])
            temporary.write_text(text, encoding="utf-8")
    _say(found)
    if report:
        identification_page.write(found, report, str(model))
    if write_model:
        typer.echo(f"model written to {write_model}")


def _simulator(
    recordings: list[Path],
    model: Path,
    fmu: Path,
    free: list[str] | None,
    files: tuple[Path | None, Path | None],
    holdout: list[Path] | None,
    json: Path | None,
    reading: Reading,
) -> None:
    from eps_hil.fmu.drive import opened
    from eps_hil.fmu.fit import fit
    from eps_hil.fmu.traces import checked, read_values, unmet
    from eps_hil.physics.model import load_model
    from eps_hil.recordings.foreign import load_columns

    mapping, values = files
    if fmu.suffix.lower() != ".fmu":
        raise InputError(fmu, "", "only an FMU can be run with other parameters", "export one")
    if not free:
        raise InputError("--free", "", "names no parameter", "give --free NAME, once for each")
    for path in holdout or []:
        if same_file(path, recordings):
            raise InputError(path, "", "is recording and hold-out", "what is fitted proves nothing")
    read = (model, fmu, *files, *recordings, *(holdout or ()), *reading.files())
    check_kept((json,), read)
    rig = load_model(model)
    columns = load_columns(mapping) if mapping else None
    known = read_values(values) if values else {}
    with opened(fmu, columns) as simulator:
        known = checked(simulator, known)
        used, kept = read_all(recordings, reading), read_all(holdout or [], reading)
        say_notes(fmu, [*simulator.notes(), *unmet(simulator, {**used, **kept})])
        with progress("fitting the simulator") as bar:
            found = fit(simulator, used, kept, rig, free, bar, known)
    for name, one in found.parameters.items():
        interval = one["ci95"]
        told = "no interval" if interval is None else f"{interval[0]:.5g} to {interval[1]:.5g}"
        typer.echo(
            f"  {name} {one['value']:.5g}{spaced(one['unit'])}  {told}  (was {one['before']:.4g})"
        )
    typer.echo(
        f"torque that the simulator lacks on {found.kept}: {1e3 * found.before_nm:.3g} mNm rms "
        f"before, {1e3 * found.after_nm:.3g} after"
    )
    for note in found.notes:
        typer.echo(f"note: {note}")
    if json:
        write_json(json, found.content())


def _say(found: "Identification") -> None:
    typer.echo(f"{found.seconds:.0f} s in {len(found.recordings)} recordings")
    shown = {**found.parameters, **found.offsets}
    width = max(len(name) for name in shown)
    for name, one in shown.items():
        typer.echo(f"  {name:{width}} {_line(one)}")
    typer.echo("differences of delays, which are what recordings show:")
    for name, skew in found.skews_s.items():
        typer.echo(f"  {name:{width}} {_line(skew)}")
    if found.motor_lag is not None:
        typer.echo(f"  {'motor_lag':{width}} {_line(found.motor_lag)}")
    typer.echo(_coverage(found))
    typer.echo("these recordings cannot tell apart, or not at all:")
    for unknown in found.cannot_tell:
        remedy = f"; to tell: {unknown.remedy}" if unknown.remedy else ""
        typer.echo(f"  {unknown.what}: {unknown.why}{remedy}")
    for finding in found.findings:
        where = ", ".join(part for part in (finding.recording, finding.signal) if part)
        typer.echo(f"note: {where + ': ' if where else ''}{finding.summary}")
    typer.echo(
        f"torque residual while sliding: {1e3 * found.residual_nm:.3g} mNm rms; "
        f"sensor noise alone: {1e3 * found.floor_nm:.3g}"
    )


def _line(one: "Estimate") -> str:
    scale, unit = (1e3, "ms") if one.unit == "s" else (1.0, of(one.unit))
    text = f"{scale * one.value:11.5g} {unit:9}"
    if one.ci95 is not None:
        text += f" {scale * one.ci95[0]:.5g} to {scale * one.ci95[1]:.5g}"
    else:
        text += f" {one.status}"
    if one.from_model is not None and one.status == "identified":
        text += f" (was {scale * one.from_model:.4g})"
    return text + (f": {one.note}" if one.note else "")


def _coverage(found: "Identification") -> str:
    table = found.map
    lines = ["seconds of steady sliding, speed in rad/s (down) over load in N (across):"]
    lines.append(" " * 14 + "".join(f"{int(low):>7}+" for low in table.loads[:-1]))
    rows = [(1, i) for i in reversed(range(len(table.speeds) - 1))]
    rows += [(0, i) for i in range(len(table.speeds) - 1)]
    for sign, i in rows:
        mark = "-" if sign else "+"
        label = f"{mark}{table.speeds[i]:g} to {mark}{table.speeds[i + 1]:g}"
        cells = "".join(
            f"{seconds:8.1f}" if seconds > 0.05 else f"{'.':>8}"
            for seconds in table.seconds[sign, i].tolist()
        )
        lines.append(f"{label:>14}{cells}")
    return "\n".join(lines)
