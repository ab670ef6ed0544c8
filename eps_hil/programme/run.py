"""A whole programme on a bus: drive the rig cell by cell, record each, go on after an interruption.

One loop and one port: receive, write to the cell's log, decode, and every 10 ms a command. When it
ends, however it ends, speed and preload go to zero and the rig is released; when it is killed, the
rig's own time-out does that.
"""

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from eps_hil.bus.codec import FrameDecoder, FrameEncoder
from eps_hil.bus.commands import Kind, of_database
from eps_hil.bus.config import BusSetup
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import load_mapping
from eps_hil.bus.port import Port, open_port
from eps_hil.bus.record import LogFile, open_log
from eps_hil.errors import BusError, EpsHilError, InputError
from eps_hil.physics.model import Model
from eps_hil.programme import cell_record
from eps_hil.programme.cell_record import MEASURED, CellResult, Collector
from eps_hil.programme.conductor import TICK_S, Conductor, Phase, Reading, Wanted
from eps_hil.programme.plan import Plan, PlannedCell
from eps_hil.recordings.files import make_folder, replacing

COMMAND = "RIG_Command"
PLAN_FILE = "programme.json"
SCHEMA = "eps-hil/programme/1"
_SILENCE_S = 1.0
_FIRST_WAIT_S = 30.0
_RELEASE_FRAMES = 5
_LONGEST_STOP_S = 3.0
_ENABLE, _RELEASE = 1.0, 0.0

OnProgress = Callable[[int, int, str], None]


class InterruptedProgrammeError(EpsHilError):
    """Somebody stopped the programme; finished cells are kept."""


@dataclass(frozen=True, slots=True)
class Summary:
    """All cells of a finished programme; ``resumed`` were there before."""

    results: Sequence[CellResult]
    resumed: int

    @property
    def accepted(self) -> list[CellResult]:
        """Cells that may be used."""
        return [one for one in self.results if one.accepted]


def prepare_folder(folder: Path, plan: Plan, *, resume: bool) -> list[CellResult]:
    """Make or check the folder of a programme; the cells that are finished already.

    :class:`InputError` where it holds finished cells and ``resume`` is not asked for, or cells of
    another programme.
    """
    file = folder / PLAN_FILE
    if not resume and any(folder.glob("cell_*.json")):
        remedy = "add --resume to go on, or choose another folder"
        raise InputError(folder, "--out", "holds finished cells of a programme", remedy)
    content = {"schema": SCHEMA, "programme": plan.content()}
    if resume and file.exists():
        try:
            same = json.loads(file.read_text(encoding="utf-8")) == content
        except (OSError, ValueError) as error:
            raise InputError(file, "", f"cannot be read: {error}", "use another folder") from None
        if not same:
            problem = "was made by another programme, or by an earlier state of this one"
            raise InputError(file, "", problem, "use another folder")
    else:
        make_folder(folder, "--out")
        with replacing(file) as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    found = (cell_record.read(cell, folder) for cell in plan.cells())
    return [one for one in found if one is not None]


class ProgrammeRun:
    """A programme, checked; :meth:`run` opens the bus and returns when every cell is finished."""

    def __init__(self, setup: BusSetup, model: Model, plan: Plan, folder: Path) -> None:
        mapping = load_mapping(setup.signals)
        database = load_database(setup.dbc, strict=mapping.strict)
        dbc_file = ", ".join(path.name for path in setup.dbc)
        self._model, self._plan, self._folder = model, plan, folder
        self._position = _position_signal(setup, mapping.signals)
        self._decoder = FrameDecoder(
            database, mapping, mapping_file=setup.signals, dbc_file=dbc_file
        )
        self._encoder = FrameEncoder(database, COMMAND, dbc_file=dbc_file)
        commands = of_database(database, marked=mapping.commands)
        self._torque_ids = [i for i, one in commands.items() if one.kind is Kind.TORQUE]
        self._channel = setup.bus.channel
        self._latest: dict[str, float] = {}
        self._sums: dict[str, list[float]] = {}
        self._log: LogFile | None = None
        self._heard_s = 0.0
        self._commanded = False
        self._bus = setup.bus
        self._port: Port

    def run(
        self,
        finished: Sequence[CellResult],
        *,
        stop: Callable[[], bool] = lambda: False,
        on_progress: OnProgress | None = None,
    ) -> Summary:
        """Run what is not finished yet, in the plan's order; the bus is let go in every case.

        :class:`InterruptedProgrammeError` after ``stop()``, :class:`BusError` when the rig is
        silent or somebody else commands it, :class:`EpsHilError` when it does not follow.
        """
        bus = self._bus
        self._port = open_port(
            bus.interface,
            bus.channel,
            fd=bus.fd,
            send_ids=(self._encoder.can_id,),
            never_send_ids=self._torque_ids,
            options=bus.options,
        )
        results = {one.cell.number: one for one in finished}
        cells = self._plan.cells()
        try:
            self._wait_for_the_rig(stop)
            for cell in cells:
                if cell.number not in results:
                    results[cell.number] = self._cell(cell, stop, len(cells), on_progress)
        finally:
            self._let_go()
        return Summary([results[cell.number] for cell in cells], len(finished))

    def _cell(
        self,
        cell: PlannedCell,
        stop: Callable[[], bool],
        total: int,
        on_progress: OnProgress | None,
    ) -> CellResult:
        """One cell, repeated while it is not good enough; its log and its result are then kept."""
        for attempt in range(1, self._plan.attempts + 1):
            conductor = Conductor(cell, self._plan, self._model)
            collector = Collector(self._model)
            part = self._folder / f"{cell.name}.part.log"
            self._log = open_log(part, self._channel, overwrite=True)
            lost = self._lost()
            try:
                self._conduct(conductor, collector, stop, total, on_progress)
            finally:
                log, self._log = self._log, None
                log.close()
            if conductor.phase is Phase.FAILED:
                raise EpsHilError(f"{cell.name}: {conductor.reason}; finished cells are kept")
            result = collector.result(cell, self._lost() - lost, attempt)
            if result.accepted:
                break
        part.replace(self._folder / f"{cell.name}.log")
        cell_record.write(result, self._folder)
        return result

    def _conduct(
        self,
        conductor: Conductor,
        collector: Collector,
        stop: Callable[[], bool],
        total: int,
        on_progress: OnProgress | None,
    ) -> None:
        """Ticks until the cell is over; samples of the measured stretch go to the collector."""
        wanted = Wanted(0.0, 0.0)
        deadline_s = time.monotonic()
        while not conductor.over:
            if stop():
                number = conductor.cell.number
                raise InterruptedProgrammeError(
                    f"interrupted in cell {number} of {total}; finished cells are kept in "
                    f"{self._folder}, go on with --resume"
                )
            deadline_s += TICK_S
            measuring = conductor.phase is Phase.MEASURE
            self._receive_until(deadline_s, collector if measuring else None)
            wanted = conductor.step(self._reading())
            self._send(wanted)
            if on_progress:
                on_progress(conductor.cell.number, total, conductor.phase.value)

    def _receive_until(self, deadline_s: float, collector: Collector | None) -> None:
        """Take frames until the deadline; at least once, however late it is."""
        while True:
            frames = self._port.recv(max(deadline_s - time.monotonic(), 0.0))
            now_s = time.monotonic()
            if self._log is not None:
                self._log.write(frames)
            self._take(frames, collector, now_s)
            if now_s >= deadline_s:
                break
        if now_s - self._heard_s > _SILENCE_S:
            raise BusError(f"{self._port.name}: the rig has been silent for {_SILENCE_S:g} s")

    def _take(self, frames: Sequence[Frame], collector: Collector | None, now_s: float) -> None:
        for frame in frames:
            if frame.can_id == self._encoder.can_id and not frame.own and not frame.error:
                can_id = f"0x{frame.can_id:X}"
                raise BusError(f"{self._port.name}: another transmitter sends {COMMAND} ({can_id})")
            samples = self._decoder.decode(frame)
            if not samples:
                continue
            self._heard_s = now_s
            if collector is not None:
                collector.take(samples)
            for name, _, value in samples:
                if math.isfinite(value):
                    self._sums.setdefault(name, []).append(value)

    def _reading(self) -> Reading:
        """Means since the last tick; what brought nothing new stays as it was."""
        for name, values in self._sums.items():
            self._latest[name] = sum(values) / len(values)
        self._sums.clear()
        position = self._latest.get(self._position, 0.0)
        if self._position == "motor_angle_rad":
            position /= self._model.rack_to_rotor_ratio_rad_per_m
        speed = self._latest.get("motor_speed_rad_s", 0.0)
        return Reading(speed, position, self._latest.get("rack_force_n", 0.0))

    def _send(self, wanted: Wanted, request: float = _ENABLE) -> None:
        wheel = wanted.speed_rad_s * self._model.sensor_to_rotor
        values = {
            "WheelSpeedSetPoint": wheel,
            "RackForceSetPoint": wanted.force_n,
            "MotorShare": 0.0,  # a torque of the motor is an armed override's to command
            "CommandRequest": request,
        }
        self._commanded = True
        frame = self._encoder.frame(values)
        if self._port.send(frame) and self._log is not None:
            self._log.write([replace(frame, t_ns=time.time_ns())])

    def _lost(self) -> int:
        return self._decoder.faults["lost_frames"] + self._port.counts.lost_in_kernel

    def _wait_for_the_rig(self, stop: Callable[[], bool]) -> None:
        """Until every signal that is needed has been heard."""
        needed = {*MEASURED, self._position}
        end_s = time.monotonic() + _FIRST_WAIT_S
        while needed - set(self._latest):
            if stop():
                raise InterruptedProgrammeError("interrupted before the first cell")
            self._heard_s = time.monotonic()
            if self._heard_s > end_s:
                missing = ", ".join(sorted(needed - set(self._latest)))
                raise BusError(f"{self._port.name}: nothing heard of {missing}; does the rig run?")
            self._receive_until(self._heard_s + 0.05, None)
            self._reading()

    def _let_go(self) -> None:
        """Speed and preload to zero, then release, if we ever commanded anything.

        A bus that is gone leaves it to the rig.
        """
        try:
            end_s = time.monotonic() + _LONGEST_STOP_S
            while self._commanded and time.monotonic() < end_s:
                self._send(Wanted(0.0, 0.0))
                self._receive_until(time.monotonic() + TICK_S, None)
                now = self._reading()
                if abs(now.speed_rad_s) < 1.0 and abs(now.force_n) < 50.0:
                    break
            for _ in range(_RELEASE_FRAMES if self._commanded else 0):
                self._send(Wanted(0.0, 0.0), _RELEASE)
        except BusError:
            pass
        finally:
            self._port.close()


def _position_signal(setup: BusSetup, signals: object) -> str:
    """Rack position, or the rotor's angle in its place; all other signals must be mapped too."""
    mapped = set(signals)  # type: ignore[call-overload]
    for name in MEASURED:
        if name not in mapped:
            raise InputError(setup.signals, name, "is not mapped; a programme needs it", "map it")
    for name in ("rack_position_m", "motor_angle_rad"):
        if name in mapped:
            return name
    problem = "neither it nor motor_angle_rad is mapped; a programme must know where the rack is"
    raise InputError(setup.signals, "rack_position_m", problem, "map one of them")
