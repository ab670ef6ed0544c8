"""``eps-hil calibrate``: friction levels adapted on the bus (CONTRACT 6)."""

import math
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eps_hil.board import Notice
from eps_hil.cli._first_answer import say_if_it_compiles
from eps_hil.cli._inputs import reads_recordings
from eps_hil.cli._levels import accept, check_calibrated_place, reset_levels
from eps_hil.cli._lines import Lines
from eps_hil.cli._outputs import check_apart
from eps_hil.cli._reversals import reversals
from eps_hil.errors import EpsHilError, InputError, SafetyStop

if TYPE_CHECKING:
    from eps_hil.adaptation.gates import GateState
    from eps_hil.adaptation.unknown_force import Shift
    from eps_hil.service.calibrated_model import Levels
    from eps_hil.service.calibration import CalibrationSettings, TorqueInjectionSource

_DRY_RUN_S = 5.0

Config = Annotated[Path, typer.Option("--config", help="Configuration of the service (YAML).")]
WriteModel = Annotated[
    Path | None, typer.Option("--write-model", help="Write the calibrated model file here.")
]
Duration = Annotated[
    float | None, typer.Option("--duration", min=0.1, help="Give up after so many seconds.")
]
Reset = Annotated[
    bool,
    typer.Option("--reset", help="No calibration: write the levels from before the first one."),
]
OutsideBand = Annotated[
    bool,
    typer.Option("--accept-outside-band", help="Accept levels far from the last accepted ones."),
]


def register(app: typer.Typer) -> None:
    """Add the verb."""
    verb = typer.Typer(no_args_is_help=True, help="Adapt the friction levels of a rig on the bus.")
    verb.command("torque-injection")(torque_injection)
    verb.command("error-injection")(error_injection)
    verb.command("reversals")(reads_recordings(reversals))
    app.add_typer(verb, name="calibrate")


def torque_injection(
    config: Config,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show the gates and the plan; send nothing at all.")
    ] = False,
    write_model: WriteModel = None,
    duration: Duration = None,
    journal: Annotated[
        Path | None,
        typer.Option(
            "--journal",
            help="Every transition is appended here; default: override-journal.jsonl beside "
            "--write-model, else in the current folder.",
        ),
    ] = None,
    reset: Reset = False,
    accept_outside_band: OutsideBand = False,
    yes_i_stand_clear: Annotated[
        bool,
        typer.Option(
            "--yes-i-stand-clear",
            help="No dead-man key: nobody is near the wheel, an emergency stop is at hand.",
        ),
    ] = False,
) -> None:
    """Ramp a motor torque until the rack moves, both ways, and read off the friction levels.

    THE MOTOR MOVES. In a terminal: press a, then y, then hold the space bar; letting go of it ends
    the torque. Exit status 3: a limit of the guard, or a gate, ended the run.
    """
    from eps_hil.service.calibration import TorqueInjectionSource, calibration_settings
    from eps_hil.service.config import load_config
    from eps_hil.service.override_setup import prepare_override

    setup = load_config(config)
    kept = journal_place(journal, write_model)
    check_apart((write_model, kept), ())
    check_calibrated_place(setup, write_model)
    if reset:
        reset_levels(setup, write_model)
        return
    settings = calibration_settings(setup, config)
    say_if_it_compiles()
    parts = prepare_override(setup, config)
    _check_plan(parts.override.limits.max_torque_nm, settings, config)
    source = TorqueInjectionSource(settings.torque_injection, parts.model)
    for line in _plan(parts, settings, dry_run):
        typer.echo(line)
    parts.estimator.warm_up()
    if not dry_run:
        typer.echo(f"journal    {kept}")
    _inject(parts, source, settings, kept, duration, dry_run=dry_run, alone=yes_i_stand_clear)
    if dry_run:
        typer.echo("dry run    nothing was sent")
        return
    said, levels, shift = _found(source)
    note = {"method": "torque_injection", "repetitions": len(source.injection.repetitions)}
    accept(levels, setup, settings, write_model, note, accept_outside_band, shift, said)


def journal_place(journal: Path | None, write_model: Path | None) -> Path:
    """Where a session's transitions are written: where it was said, else beside the model."""
    if journal is not None:
        return journal
    return (write_model.parent if write_model else Path()) / "override-journal.jsonl"


def error_injection(
    config: Config,
    write_model: WriteModel = None,
    duration: Duration = None,
    reset: Reset = False,
    accept_outside_band: OutsideBand = False,
) -> None:
    """Learn the friction levels while driver and ECU move the rack. Listens only, sends nothing."""
    import asyncio

    from eps_hil.physics.model import load_model
    from eps_hil.service.calibration import ErrorInjectionSource, calibration_settings
    from eps_hil.service.config import load_config
    from eps_hil.service.listening import Listener
    from eps_hil.service.online_methods import warm_up_error_injection

    setup = load_config(config)
    check_calibrated_place(setup, write_model)
    if reset:
        reset_levels(setup, write_model)
        return
    settings = calibration_settings(setup, config)
    model = load_model(setup.model)
    say_if_it_compiles()
    source = ErrorInjectionSource(settings, model)
    warm_up_error_injection(settings.error_injection, model)
    listener = Listener(setup, source)
    notice = Notice("calibration", str(setup.bus), "error injection (listens only)")
    show = _Display(
        lambda: source.gates, lambda: _sliding(source.state, settings), notice,
        lambda: (_slid_s(source.state), settings.error_sliding_s),
    )  # fmt: skip
    typer.echo(f"bus        {setup.bus}\nsend       nothing (error injection listens)\nREADY")
    try:
        asyncio.run(listener.run(lambda: source.over, show, duration, settings.silence_s))
    finally:
        show.end()
    state = source.state
    if state is None:
        raise EpsHilError("no sync frame was received: is the rig on this bus?")
    slid = f"slid       {state.time_pos_s:.1f} s forth, {state.time_neg_s:.1f} s back"
    if not source.over or state.at_limit:
        typer.echo(slid)
        why = "a level stands at its limit" if source.over else "not enough sliding with gates met"
        raise EpsHilError(f"no levels: {why} (wanted {settings.error_sliding_s:g} s each way)")
    from eps_hil.service.calibrated_model import Levels

    levels = Levels(state.levels.positive_nm, state.levels.negative_nm)
    note = {"method": "error_injection", "sliding_s": [state.time_pos_s, state.time_neg_s]}
    accept(levels, setup, settings, write_model, note, accept_outside_band, said=[slid])


# The run.


def _inject(
    parts: Any,
    source: "TorqueInjectionSource",
    settings: "CalibrationSettings",
    journal_file: Path,
    duration: float | None,
    *,
    dry_run: bool,
    alone: bool,
) -> None:
    """One session, to its end; :class:`SafetyStop` if a limit or a gate ended it."""
    import asyncio

    from eps_hil.service.journal import Journal
    from eps_hil.service.operator import HINT, Operator, Unattended, terminal_operator
    from eps_hil.service.override_session import OverrideSession

    operator: Operator | None = None
    if not dry_run:
        operator = Unattended() if alone else terminal_operator()
        typer.echo("operator   none: unattended" if alone else f"operator   {HINT}")
    notice = Notice("calibration", str(parts.config.bus), _title(parts, dry_run=dry_run))
    show = _Display(lambda: source.gates, lambda: _progress(source), notice, lambda: _ramps(source))
    journal = Journal(None if dry_run else journal_file)
    session = OverrideSession(
        parts, source, operator, show.lines.say, over=lambda: source.over,
        show=lambda _: show(), journal=journal, silence_s=settings.silence_s,
    )  # fmt: skip
    if dry_run and duration is None:
        duration = _DRY_RUN_S
    try:
        asyncio.run(session.run(duration))
    finally:
        journal.close()
        show.end()
    if session.fault is not None:
        raise SafetyStop(f"the torque guard ended the run: {session.fault.why}")
    if source.aborted:
        raise SafetyStop(f"the injection was given up: {source.aborted}")
    if not session.core.syncs:
        raise EpsHilError("no sync frame was received: is the rig on this bus?")


def _check_plan(guard_nm: float, settings: "CalibrationSettings", file: Path) -> None:
    wanted_nm = settings.torque_injection.max_torque_nm
    if wanted_nm > guard_nm:
        raise InputError(
            file, "calibration.torque_injection.max_torque_nm",
            f"{wanted_nm:g} Nm is more than the guard's {guard_nm:g} Nm",
            "lower it below override.limits.max_torque_nm",
        )  # fmt: skip


def _plan(parts: Any, settings: "CalibrationSettings", dry_run: bool) -> Iterable[str]:
    injection = settings.torque_injection
    yield f"bus        {parts.config.bus}"
    yield f"model      {parts.config.model}"
    yield (
        f"plan       {injection.repetitions} ramps each way at {injection.ramp_nm_per_s:g} Nm/s up "
        f"to {injection.max_torque_nm:g} Nm at the rotor; the guard ends it beyond "
        f"{parts.override.limits.max_torque_nm:g} Nm"
    )
    ids = ", ".join(f"0x{can_id:X}" for can_id in parts.send_ids)
    yield "send       nothing (dry run)" if dry_run else f"send       {ids}"


def _found(source: "TorqueInjectionSource") -> "tuple[list[str], Levels, Shift]":
    """Of a complete run: a line for each ramp, and the levels.

    :class:`EpsHilError` where something speaks against them.
    """
    from eps_hil.service.calibrated_model import Levels

    result = source.injection.result
    if result is None:
        raise EpsHilError("the run ended before both directions were measured; nothing is written")
    said = [
        f"ramp {one.number:2d}    {'+' if one.direction > 0 else '-'}  "
        f"k0 {one.offset_nm:.4f} Nm  (break-away seen by {one.seen})"
        f"{'  left out' if one.outlier else ''}"
        for one in result.repetitions
    ]
    if not result.accepted:
        for line in said:
            typer.echo(line)
        raise EpsHilError(f"not accepted: {'; '.join(result.problems)}")
    pos, neg = result.positive, result.negative
    levels = Levels(pos.offset_nm, neg.offset_nm, pos.ci95_nm, neg.ci95_nm)
    return said, levels, result.shift


# What is shown.


def _progress(source: "TorqueInjectionSource") -> str:
    command = source.command
    if command is None:
        return "not armed"
    said = (
        f"{command.phase} {command.torque_nm:+.3f} Nm  {command.repetition}/{command.repetitions}"
    )
    return f"{said}  {command.reason}".rstrip()


def _sliding(state: Any, settings: "CalibrationSettings") -> str:
    if state is None:
        return "no input"
    return (
        f"k0+ {state.levels.positive_nm:.4f} k0- {state.levels.negative_nm:.4f} Nm  slid "
        f"{state.time_pos_s:.1f} and {state.time_neg_s:.1f} of {settings.error_sliding_s:g} s"
    )


def _title(parts: Any, *, dry_run: bool) -> str:
    most = f"up to {parts.override.limits.max_torque_nm:g} Nm"
    return "torque injection, dry run" if dry_run else f"torque injection, {most} at the rotor"


def _ramps(source: "TorqueInjectionSource") -> tuple[float, float]:
    command = source.command
    return (0.0, 0.0) if command is None else (command.repetition, command.repetitions)


def _slid_s(state: Any) -> float:
    return 0.0 if state is None else float(min(state.time_pos_s, state.time_neg_s))


class _Display:
    """Gates and progress: a live line on a terminal, in a pipe a line when a gate changes.

    The same goes to the board, where a page finds it; ``done`` gives how much, of how much.
    """

    def __init__(
        self,
        gates: Callable[[], tuple["GateState", ...]],
        progress: Callable[[], str],
        notice: Notice,
        done: Callable[[], tuple[float, float]],
    ) -> None:
        self._gates, self._progress = gates, progress
        self._notice, self._done = notice, done
        self._live = sys.stderr.isatty()
        self.lines = Lines(live=self._live)
        self._met: dict[str, bool] = {}

    def __call__(self) -> None:
        """Called ten times a second."""
        gates = self._gates()
        done, of = self._done()
        self._notice.put(
            text=self._progress(), done=done, of=of,
            gates=[
                {"name": gate.name, "met": gate.met, "unit": gate.unit, "limit": gate.limit,
                 "value": gate.value if math.isfinite(gate.value) else None}
                for gate in gates
            ],
        )  # fmt: skip
        for gate in gates:
            if self._met.get(gate.name) != gate.met:
                self._met[gate.name] = gate.met
                if not self._live:
                    self.lines.say(f"gate       {self._words(gate)}")
        if self._live:
            closed = [self._words(gate) for gate in gates if not gate.met]
            said = "; ".join(closed) if closed else "all gates met"
            self.lines.show(f"{self._progress()}  |  {said}"[:156])

    @staticmethod
    def _words(gate: "GateState") -> str:
        met = "met" if gate.met else "NOT MET"
        return f"{gate.name} {met}: {gate.value:.4g} {gate.unit} (limit {gate.limit:g})"

    def end(self) -> None:
        """Leave the line, and the last word on the board."""
        done, of = self._done()
        self._notice.end(text=f"ended: {self._progress()}", done=done, of=of)
        self.lines.end()
