"""``eps-hil diagnose``: what physics does the model lack? (CONTRACT 6, 7)."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eps_hil.cli._files import check_kept, check_model_place, write_json
from eps_hil.cli._first_answer import say_if_it_compiles
from eps_hil.cli._inputs import (
    ModelPath,
    Reading,
    progress,
    read_all,
    reads_recordings,
    same_file,
    say_notes,
    stages,
)
from eps_hil.unit_words import spaced

if TYPE_CHECKING:
    from eps_hil.diagnosis.given_load import Diagnosis
    from eps_hil.series import Series

_TOO_LONG_MIN = 60.0
"""A test that needs longer than this to separate two effects does not separate them."""


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("diagnose")(reads_recordings(diagnose))


def _ids(incomplete: str) -> list[str]:
    """For the shell: effects that may be left out."""
    from eps_hil.physics.effects.catalogue import catalogue

    return [name for name in sorted(catalogue()) if name.startswith(incomplete)]


def diagnose(
    model: ModelPath,
    recording: Annotated[
        list[Path], typer.Option("--recording", help="Recordings to explain, one or more.")
    ],
    holdout: Annotated[
        list[Path] | None,
        typer.Option("--holdout", help="Recordings kept from the fit, to judge it."),
    ] = None,
    simulation: Annotated[
        list[Path] | None,
        typer.Option(
            "--simulation",
            metavar="SIM...",
            help="Traces of your own simulator for the same manoeuvres, or it itself as one FMU:"
            " what does it lack, and what does it have too many?",
        ),
    ] = None,
    simulation_signals: Annotated[
        Path | None,
        typer.Option(
            "--simulation-signals",
            help="Mapping (YAML) of the traces' columns, or the FMU's variables, to our names.",
        ),
    ] = None,
    simulation_values: Annotated[
        Path | None,
        typer.Option(
            "--simulation-values",
            help="Parameters of the FMU (YAML, name: value; or the JSON of identify --simulation).",
        ),
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", help="The result as JSON.")] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="The result as one HTML page, for people.")
    ] = None,
    write_model: Annotated[
        Path | None, typer.Option("--write-model", help="Model file with the effects added.")
    ] = None,
    write_effect: Annotated[
        Path | None,
        typer.Option(
            "--write-effect",
            metavar="FILE.py",
            help="The law found for what has no name, as a catalogue file ready for review.",
        ),
    ] = None,
    write_manoeuvre: Annotated[
        Path | None,
        typer.Option(
            "--write-manoeuvre",
            help="The rig test that best tells the findings from what else they could be.",
        ),
    ] = None,
    without_effect: Annotated[
        list[str] | None,
        typer.Option(
            "--without-effect",
            metavar="ID",
            help="Do not consider this effect; may repeat.",
            autocompletion=_ids,
        ),
    ] = None,
    trust_channels: Annotated[
        bool,
        typer.Option(
            "--trust-channels",
            help="Say, and do not refuse, that a channel looks like another unit, sign or column.",
        ),
    ] = False,
    *,
    reading: Reading,
) -> None:
    """Locate where recordings and model differ, name the missing physics, and show the gain.

    Needs motor torque, and rotor speed or angle; torsion-bar torque where a driver or robot turns
    the wheel. Without the rack force less can be told, without --holdout a part of the recordings
    is kept from the fit. With --simulation the question is what the recordings hold and those
    traces lack.
    """
    import eps_hil
    from eps_hil.api.jobs import known_effects
    from eps_hil.errors import InputError
    from eps_hil.physics.model import dump_model, load_model
    from eps_hil.recordings.files import replacing

    check_kept(
        (json, report, write_model, write_manoeuvre, write_effect),
        (model, *recording, *(holdout or []), *(simulation or [])),
    )
    check_model_place(write_model)
    if write_effect:
        _check_effect(write_effect)
    _check_simulation(simulation or [], simulation_signals, simulation_values)
    if report:
        from eps_hil.report import diagnosis_page, page

        page.check("--report", "uplot")
    rig = load_model(model)
    without = known_effects(without_effect or [], "--without-effect")
    for path in holdout or []:
        if same_file(path, recording):
            raise InputError(path, "", "is recording and hold-out", "what is fitted proves nothing")
    fitted = read_all(recording, reading)
    judged = read_all(holdout or [], reading)
    say_if_it_compiles()
    with stages("aligning the recordings") as say:
        traces = None
        if simulation and _one_fmu(simulation):
            together = {**fitted, **judged}
            try:
                traces = _fmu_traces(
                    simulation[0], simulation_signals, simulation_values, together, rig
                )
            except ValueError as error:
                raise InputError(", ".join(together), "", str(error)) from error
        elif simulation:
            traces = _traces(simulation, simulation_signals)
        result = eps_hil.diagnose(
            [eps_hil.Recording(name, series) for name, series in fitted.items()],
            rig,
            holdouts=[eps_hil.Recording(name, series) for name, series in judged.items()],
            without_effects=without,
            simulation=traces,
            trust_channels=trust_channels,
            on_progress=say,
        ).result
    if write_model:  # written first: nobody may be there to read what is said
        with replacing(write_model) as temporary:
            temporary.write_text(dump_model(result.model), encoding="utf-8")
    if json:
        write_json(json, result.content)
    _say(result.content)
    if write_model:
        base = "the simulator's own numbers and " if simulation else ""
        what = _counted(len(result.model.effects))
        typer.echo(f"model with {base}{what} written to {write_model}")
    if write_effect:
        _write_effect(result, write_effect)
    if report:
        with progress("drawing the page"):
            diagnosis_page.write(result, report, str(model))
        typer.echo(f"page: {report}")
    if write_manoeuvre:  # last: it simulates, and what was found is written by then
        _advise(result, write_manoeuvre)


def _counted(effects: int) -> str:
    return f"{effects} effect{'' if effects == 1 else 's'}"


def _check_effect(path: Path) -> None:
    """The file's name is the effect's id: it must be one, and none that the catalogue has."""
    from eps_hil.errors import InputError
    from eps_hil.physics.effects.catalogue import catalogue

    if path.suffix != ".py" or not path.stem.isidentifier():
        remedy = "a file name like my_effect.py, which becomes its id"
        raise InputError("--write-effect", "", f"'{path.name}' names no effect", remedy)
    if path.stem in catalogue():
        raise InputError("--write-effect", "", f"the catalogue has '{path.stem}'", "another name")


def _write_effect(result: "Diagnosis", path: Path) -> None:
    from eps_hil.diagnosis.remainder.as_effect import as_effect
    from eps_hil.recordings.files import replacing

    entries = [] if result.remainder is None else result.remainder.entries
    laws = [entry for entry in entries if "values" not in entry]
    if not laws:
        typer.echo("no law without a name was found: no effect is written")
        return
    text = as_effect(laws[0], path.stem)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    more = "" if len(entries) == 1 else f", the first of {len(entries)} terms that were found"
    typer.echo(f"effect {path.stem} written to {path}{more}: review it, then put it into "
               "eps_hil/physics/effects")  # fmt: skip


def _check_simulation(paths: list[Path], signals: Path | None, values: Path | None) -> None:
    from eps_hil.errors import InputError

    if signals and not paths:
        raise InputError("--simulation-signals", "", "goes with --simulation", "give the traces")
    if not _one_fmu(paths):
        if values:
            raise InputError("--simulation-values", "", "goes with --simulation and an FMU")
        return
    from eps_hil.fmu.described import read_fmu

    read_fmu(paths[0])


def _one_fmu(paths: list[Path]) -> bool:
    from eps_hil.errors import InputError

    fmus = [path for path in paths if path.suffix.lower() == ".fmu"]
    if fmus and len(paths) > 1:
        raise InputError(fmus[0], "", "stands beside other traces", "give one FMU, or traces alone")
    return bool(fmus)


def _fmu_traces(
    path: Path, mapping: Path | None, values: Path | None, recordings: Any, rig: Any
) -> "dict[str, Mapping[str, Series]]":
    from eps_hil.fmu.traces import read_values, traces_of
    from eps_hil.recordings.foreign import load_columns

    columns = load_columns(mapping) if mapping else None
    known = read_values(values) if values else None
    traces, notes = traces_of(path, recordings, rig, columns, known)
    say_notes(path, notes)
    return traces


def _traces(paths: list[Path], mapping: Path | None) -> "dict[str, Mapping[str, Series]]":
    from eps_hil.recordings.foreign import load_columns, read_foreign

    columns = load_columns(mapping) if mapping else None
    found = {}
    for path in paths:
        one = read_foreign(path, columns)
        say_notes(path, one.notes)
        found[str(path)] = one.series
    return found


def _say(content: Mapping[str, Any]) -> None:
    from eps_hil.diagnosis.verdict.spoken import (
        all_clear,
        but,
        most_in_words,
        shares_in_words,
        when_in_words,
    )
    from eps_hil.physics.effects.catalogue import catalogue

    limits = content.get("limits", [])
    words = {
        "no_mismatch": f"{all_clear(limits)}{':' if limits else '.'}",
        "explained": f"The mismatch is explained{but(limits)}:",
        "partly_explained": f"The mismatch is explained in part{but(limits)}:",
        "unknown_effect": "Something is missing that the catalogue does not hold:",
    }
    typer.echo(words[content["verdict"]])
    for finding in content["findings"]:
        known = catalogue().get(finding["effect"])
        title = f"{known.name} [{finding['effect']}]" if known else finding["effect"]
        typer.echo(f"  {title} ({100 * finding['confidence']:.0f} %): {finding['summary']}")
        for told in shares_in_words(finding["where"]):
            typer.echo(f"    {told}")
        if finding["confusable_with"]:
            typer.echo(f"    could also be {', '.join(finding['confusable_with'])}; "
                       f"{finding['next_experiment']}")  # fmt: skip
    location = content.get("location", {})
    most = most_in_words(location)
    if most:
        typer.echo(f"  stands out most: {most}")
    when = when_in_words(content.get("time_segments", []), location.get("recordings", []))
    if when:
        typer.echo(f"  when: {when}")
    for limit in limits:
        typer.echo(f"  note: {limit}")
    _say_simulation(content.get("simulation"))
    holdout = content["fit"]["holdout"]
    units = {"torque_nrmse": "", "speed_fit_percent": " %", "rack_force_rmse_n": " N"}
    for name, unit in units.items():
        if all(holdout[one].get(name) is not None for one in ("baseline", "augmented")):
            typer.echo(f"  on hold-outs, {name}: {holdout['baseline'][name]:.4g}{unit} before, "
                       f"{holdout['augmented'][name]:.4g}{unit} after")  # fmt: skip
    runs = [holdout[one].get("free_run", {}) for one in ("baseline", "augmented")]
    for name, unit in {"speed_rmse_rad_s": "rad/s", "angle_rmse_rad": "rad"}.items():
        before, after = (run.get(name) for run in runs)
        if before is not None and after is not None:
            typer.echo(f"  free run of the hold-outs, {name}: {before:.4g} {unit} before, "
                       f"{after:.4g} {unit} after")  # fmt: skip
    typer.echo(f"  sensor noise alone: torque_nrmse {holdout['noise_floor']['torque_nrmse']:.4g}")
    joint = content["kinematics"]
    seen = any(one.get("seen_in") == "kinematics" for one in content["findings"])
    if seen and "rms_left_rad" in joint:
        kept = "holdout_left_rad" in joint
        of = ("holdout_rms_rad", "holdout_left_rad") if kept else ("rms_rad", "rms_left_rad")
        before, after, noise = (1e3 * joint[one] for one in (*of, "noise_rad"))
        typer.echo(f"  {'on hold-outs, ' if kept else ''}rotor against rack: {before:.3g} mrad "
                   f"before, {after:.3g} mrad after; sensor noise alone {noise:.3g}")  # fmt: skip


def _advise(result: "Diagnosis", path: Path) -> None:
    """Simulate the menu of rig tests; write the one that separates the least sure finding."""
    from eps_hil.diagnosis.direct.zero_reading import zero_readings
    from eps_hil.diagnosis.verdict.advise import advise
    from eps_hil.recordings.files import replacing
    from eps_hil.rig.menu import menu, write

    content = result.content
    entries = {entry["effect"]: entry for entry in result.model.effects}
    unsure = [f for f in content["findings"] if f["confusable_with"] and f["effect"] in entries]
    if not unsure:
        typer.echo("no finding has a rival: no manoeuvre is needed, and none written")
        return
    finding = min(unsure, key=lambda one: float(one["confidence"]))
    name, rivals = finding["effect"], finding["confusable_with"]
    with progress("simulating rig tests") as bar:
        tests = menu(result.problem.model, bar)
    recordings, model = result.problem.recordings, result.problem.model
    read = zero_readings(recordings, model, ()).settled
    advice = advise(model, entries[name], rivals, tests, read)
    content["next_manoeuvre"] = {
        "effect": name,
        "against": rivals,
        "tests": [one.content() for one in advice],
    }
    best = advice[0]
    if not best.minutes < _TOO_LONG_MIN:
        typer.echo(f"no test of the menu tells {name} from {', '.join(rivals)}; none written")
        return
    why = f"tells {name} from {', '.join(rivals)}: run it for {best.minutes:.1g} min or more"
    with replacing(path) as temporary:
        write(best.manoeuvre, why, temporary)
    typer.echo(f"manoeuvre {best.manoeuvre} written to {path}: {why}")


def _say_simulation(simulation: Mapping[str, Any] | None) -> None:
    if simulation is None:
        return
    for one in simulation["traces"]:
        if one["recording"] is not None:
            typer.echo(f"  {one['file']} is {one['recording']}, {one['offset_s']:+.4f} s apart")
    numbers = [
        f"{name} {one['value']:.4g}{spaced(one['unit'])} (file: {one['model_file']:.4g})"
        for name, one in simulation["parameters"].items()
    ]
    effects = [
        f"{one['effect']} ({', '.join(_size(k, v) for k, v in one.items() if k != 'effect')})"
        for one in simulation["effects"]
    ]
    if numbers or effects:
        typer.echo(f"  the simulator is your model file with {', '.join([*numbers, *effects])}")
    differences = simulation["differences"]
    for one in differences["simulator_only"]:
        for name, there in one["rig"].items():
            typer.echo(
                f"  too many in the simulator: {one['effect']}; {name} "
                f"{one['parameters'][name]:.3g}{spaced(there['unit'])}, "
                f"on the rig {there['value']:.2g}"
            )
    for one in differences["numbers"]:
        typer.echo(f"  another number: {one['summary']}")
    if differences["same"]:
        typer.echo(f"  both have: {', '.join(differences['same'])}")
    if differences["undecided"]:
        typer.echo(f"  not decided whether the rig has: {', '.join(differences['undecided'])}")
    for caveat in simulation["caveats"]:
        typer.echo(f"  note: {caveat}")


def _size(name: str, value: Any) -> str:
    return f"{name} {value:.4g}" if isinstance(value, float) else name
