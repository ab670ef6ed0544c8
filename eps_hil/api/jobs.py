"""The jobs of a program: load, recording, estimate, simulate, identify, diagnose, changes,
compare, and ``fit_simulator``."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from eps_hil.api.recording import Recording
from eps_hil.api.results import (
    Comparison,
    Diagnosis,
    Estimate,
    Identification,
    Simulation,
    SimulatorFit,
)
from eps_hil.errors import InputError
from eps_hil.estimation.levels import LevelChange
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.stream import Trace
from eps_hil.physics.model import Delays, Model, load_model
from eps_hil.series import Series

Source = Recording | str | Path
"""A recording, or a file that :func:`load` reads without further options."""
Sources = Source | Sequence[Source]
Rig = Model | str | Path


def load(
    path: str | Path,
    *,
    dbc: str | Path | Sequence[str | Path] = (),
    signals: str | Path | None = None,
    gaps: str = "refuse",
    ignore_unknown: bool = False,
    channel: str | None = None,
) -> Recording:
    """Read CSV, Parquet, MF4 or a CAN log; a CAN log needs ``dbc`` and ``signals`` (a mapping).

    ``gaps``: "refuse" or "mark" NaN and holes; ``ignore_unknown``: leave out columns without a
    canonical name; ``channel``: the one bus to read. :class:`InputError` names file and remedy.
    """
    from eps_hil.recordings.read import read_recording

    _check_gaps(gaps)
    if not isinstance(path, str | Path):
        raise _no_recording(path)
    databases = [dbc] if isinstance(dbc, str | Path) else dbc
    found = read_recording(
        path,
        dbc=[Path(one) for one in databases],
        signals=None if signals is None else Path(signals),
        gaps=gaps,
        ignore_unknown=ignore_unknown,
        channel=channel,
    )
    return Recording(found.name, found.series, found.notes, found.arrivals, found.pace)


def recording(
    columns: Any, name: str = "recording", *, gaps: str = "refuse", ignore_unknown: bool = False
) -> Recording:
    """A recording of a data frame, or of a mapping of equally long arrays (n,).

    ``time_s`` (s, or datetime64) or ``time_ns`` increases; the other columns have canonical names;
    NaN where a row has no sample of a signal. Else as :func:`load`.
    """
    from eps_hil.recordings.in_memory import from_arrays

    _check_gaps(gaps)
    found = from_arrays(columns, name, gaps=gaps, ignore_unknown=ignore_unknown)
    return Recording(found.name, found.series, found.notes)


def estimate(
    recording: Source,
    model: Rig,
    settings: EstimatorSettings | str | Path | None = None,
    *,
    changes: Sequence[LevelChange] = (),
) -> Estimate:
    """The rack force of a recording, through the estimator that runs live.

    ``settings``: an estimator settings file or value; default: the live service's (what a log's
    mapping says of a derived speed and of the cycle goes before). ``changes``: friction levels that
    were taken over while it ran (those within the recording count).
    """
    from eps_hil.estimation import batch
    from eps_hil.estimation.score import score
    from eps_hil.estimation.settings import at_pace, problem

    read, rig = _recording(recording), _model(model)
    chosen = at_pace(_settings(settings), read.pace)
    if wrong := problem(chosen, live=False):
        raise InputError("settings", "kind", wrong)
    try:
        batch.check_rate(read.series)
        within = [one for one in changes if batch.spans(read.series, one.t_ns)]
        trace = batch.estimate(read.series, rig, chosen, changes=within, arrivals=read.arrivals)
        latency_s = batch.latency_s(rig, chosen, batch.sample_periods_s(read.series))
    except ValueError as error:
        raise _refused(read, error) from error
    if not len(trace.t_ns):
        remedy = f"record more than {latency_s:.3f} s"
        raise InputError(read.name, "", "is too short for one estimate", remedy)
    return Estimate(read, rig, trace, score(trace, read.series, rig), latency_s)


def simulate(recording: Source, model: Rig, *, physical: bool = False) -> Simulation:
    """The recorded motor torque, torsion-bar torque and rack force through the model.

    ``physical``: at physical instants, not as late as the sensors report. ``notes`` of the result:
    what an input was taken for where it has no good sample.
    """
    from eps_hil.physics.forward import InputMissingError, forward
    from eps_hil.recordings.coverage import invented

    read = _recording(recording)
    try:
        made = forward(_model(model), read.series, physical=physical)
    except InputMissingError as error:
        raise _refused(read, error) from error
    drives = ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")
    told = invented(read.series, (*drives, "motor_speed_rad_s"), drives[0])
    return Simulation(read, made.t_ns, made.columns, (*made.notes, *told))


def identify(
    recordings: Sources, model: Rig, *, on_progress: Callable[[float], None] | None = None
) -> Identification:
    """Delays, inertia, friction map and bristle of a rig; the model gives what is not shown."""
    from eps_hil.identification.identify import identify as run

    (read,) = _groups(recordings)
    return Identification(run(_by_name(read), _model(model), on_progress))


def fit_simulator(
    recordings: Sources,
    model: Rig,
    simulation: str | Path,
    free: Sequence[str],
    *,
    holdouts: Sources = (),
    simulation_signals: str | Path | None = None,
    simulation_values: Mapping[str, float] | None = None,
) -> SimulatorFit:
    """Parameters of your own simulator, an FMU, that leave least torque unexplained.

    ``free``: names of its parameters, or "name=low:high"; ``simulation_signals``: a mapping (YAML)
    of its variables, where their names do not say enough; ``simulation_values``: other parameters
    and switches. The model gives the sensors' delays.
    """
    from eps_hil.fmu.drive import opened
    from eps_hil.fmu.fit import fit
    from eps_hil.fmu.traces import checked, unmet

    used, kept = _groups(recordings, holdouts)
    together = _by_name([*used, *kept])
    with opened(Path(simulation), _columns(simulation_signals)) as simulator:
        notes = (*simulator.notes(), *unmet(simulator, together))
        first = {one.name: together[one.name] for one in used}
        rest = {one.name: together[one.name] for one in kept}
        known = checked(simulator, simulation_values or {})
        found = fit(simulator, first, rest, _model(model), free, values=known)
        return SimulatorFit(found, notes)


def _columns(mapping: str | Path | None) -> Any:
    from eps_hil.recordings.foreign import load_columns

    return None if mapping is None else load_columns(Path(mapping))


def diagnose(
    recordings: Sources,
    model: Rig,
    *,
    holdouts: Sources = (),
    without_effects: Collection[str] = (),
    simulation: str | Path | Mapping[str, Mapping[str, Series]] | None = None,
    simulation_signals: str | Path | None = None,
    simulation_values: Mapping[str, float] | None = None,
    trust_channels: bool = False,
    on_progress: Callable[[str, float], None] | None = None,
) -> Diagnosis:
    """Which physics the model lacks, with confidence, intervals and the gain on hold-outs.

    Without ``holdouts`` a part of the recordings is kept from the fit. Recordings need names of
    their own. With ``simulation``, your own simulator as an FMU or its traces by name, it is that
    which is judged; ``simulation_signals`` maps its variables (YAML), ``simulation_values`` sets
    its parameters. ``trust_channels``: say, and do not refuse, that a channel looks like another.
    :class:`InputError` where a recording lacks what a diagnosis needs.
    """
    from eps_hil.diagnosis.against import diagnose_against
    from eps_hil.diagnosis.data.intake import RecordingError
    from eps_hil.diagnosis.diagnose import diagnose as run

    without_effects = known_effects(without_effects, "without_effects")
    fitted, judged = _groups(recordings, holdouts)
    together, rig = _by_name([*fitted, *judged]), _model(model)
    first = {one.name: together[one.name] for one in fitted}
    rest = {one.name: together[one.name] for one in judged}
    try:
        if simulation is None:
            return Diagnosis(
                run(rig, first, rest, on_progress, without_effects, trust_channels=trust_channels)
            )
        traces = simulation
        if isinstance(traces, str | Path):
            from eps_hil.fmu.traces import traces_of

            mapping, values = _columns(simulation_signals), simulation_values
            traces, _ = traces_of(Path(traces), together, rig, mapping, values)
        trusted = {"trust_channels": trust_channels}
        return Diagnosis(
            diagnose_against(traces, rig, first, rest, on_progress, without_effects, **trusted)
        )
    except RecordingError as error:
        raise InputError(error.recording, "", str(error)) from error
    except ValueError as error:
        raise InputError(", ".join(together), "", str(error)) from error


def known_effects(names: Collection[str], option: str) -> frozenset[str]:
    """The ids, all of the catalogue; :class:`InputError` names one that is not."""
    from difflib import get_close_matches

    from eps_hil.physics.effects.catalogue import catalogue

    for name in names:
        if name not in catalogue():
            near = get_close_matches(name, catalogue(), n=1)
            remedy = f"did you mean '{near[0]}'?" if near else "docs/reference-effects.md lists all"
            raise InputError(option, "", f"'{name}' is no effect", remedy)
    return frozenset(names)


def changes(before: Sources, after: Sources, model: Rig) -> Diagnosis:
    """What the rig does in the recordings ``after`` that it did not do ``before``.

    The diagnosis of the second state against all that was found in the first; each finding of its
    ``content`` holds ``change``. :class:`InputError` where a recording lacks what it needs.
    """
    from eps_hil.diagnosis.changes import changes as run
    from eps_hil.diagnosis.data.intake import RecordingError

    first, second = (_by_name(each) for one in (before, after) for each in _groups(one))
    try:
        found = run(_model(model), first, second)
        return Diagnosis(found.after, found.model)
    except RecordingError as error:
        raise InputError(error.recording, "", str(error)) from error
    except ValueError as error:
        raise InputError(", ".join([*first, *second]), "", str(error)) from error


def compare(
    recording: Source,
    model: Rig,
    settings: EstimatorSettings | str | Path | None = None,
    *,
    published: Trace | None = None,
    second: bool = False,
) -> Comparison:
    """The estimator with and without compensation and extensions, against the load cell.

    ``settings``: as of :func:`estimate`. ``published``: what a running service made of it;
    ``second`` adds the estimators beside the paper's.
    """
    from eps_hil.report import comparison

    read, rig = _recording(recording), _model(model)
    found = comparison.compare(read, rig, _settings(settings), published, second=second)
    return Comparison(read, rig, tuple(found))


def _settings(given: EstimatorSettings | str | Path | None) -> EstimatorSettings:
    from eps_hil import yaml_file

    if isinstance(given, str | Path):
        return yaml_file.load(given, EstimatorSettings)
    if given is not None and not isinstance(given, EstimatorSettings):
        kind = type(given).__name__
        raise InputError("settings", "", f"are of type {kind}", "give a file or EstimatorSettings")
    return given or EstimatorSettings()


def _recording(source: Source) -> Recording:
    return source if isinstance(source, Recording) else load(source)


def _no_recording(source: object) -> InputError:
    kind = type(source).__name__
    remedy = "give a file, or make one of arrays or a data frame with eps_hil.recording"
    return InputError(f"a value of type {kind}", "", "is no recording", remedy)


def _check_gaps(gaps: str) -> None:
    if gaps not in ("refuse", "mark"):
        raise InputError("gaps", "", f"is {gaps!r}", "'refuse' or 'mark'")


def _groups(first: Sources, *others: Sources) -> list[list[Recording]]:
    """The recordings of each; files of one name are called by their paths.

    :class:`InputError` where the first group is empty.
    """
    listed = [_listed(one) for one in (first, *others)]
    if not listed[0]:
        raise InputError("recordings", "", "hold none", "give one or several")
    read = [[_recording(one) for one in sources] for sources in listed]
    names = Counter(one.name for each in read for one in each)
    return [
        [
            one
            if names[one.name] == 1 or isinstance(source, Recording)
            else replace(one, name=str(source))
            for source, one in zip(*pair, strict=True)
        ]
        for pair in zip(listed, read, strict=True)
    ]


def _listed(sources: Sources) -> Sequence[Source]:
    if isinstance(sources, Recording | str | Path):
        return [sources]
    if isinstance(sources, Mapping) or not isinstance(sources, Iterable):
        raise _no_recording(sources)
    return list(sources)


def _by_name(recordings: Sequence[Recording]) -> dict[str, Mapping[str, Series]]:
    names = [one.name for one in recordings]
    for name in names:
        if names.count(name) > 1:
            raise InputError(name, "", "is given twice", "give each recording a name of its own")
    return {one.name: one.series for one in recordings}


def _model(rig: Rig) -> Model:
    """A file's model, or one that a program holds: with ``dataclasses.replace`` nobody looked."""
    if isinstance(rig, str | Path):
        return load_model(rig)
    if not isinstance(rig, Model):
        kind = type(rig).__name__
        raise InputError(f"a value of type {kind}", "", "is no model", "give a file or a Model")
    from dataclasses import asdict

    from pydantic import TypeAdapter, ValidationError

    try:
        TypeAdapter(Model).validate_python(asdict(rig))
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"]))
        raise InputError("model", field, first["msg"], f"found {first['input']!r}") from error
    if not isinstance(rig.delays_s, Delays):
        raise InputError("model", "delays_s", "are no Delays", "give eps_hil's own value")
    return rig


def _refused(recording: Recording, error: Exception) -> InputError:
    there: Any = ", ".join(sorted(recording.series))
    return InputError(recording.name, "", str(error), f"it holds {there}")
