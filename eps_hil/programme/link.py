"""The one way to a rig's set-points: one port, ``RIG_Command`` alone, zero and release at its end.

Whatever leads a rig (a programme's cells, an investigation's experiments) is stepped from here:
receive, write to the log, decode, and every 10 ms a command. When it ends, however it ends, speed
and preload go to zero and the rig is released; when it is killed, the rig's own time-out does that.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

from eps_hil.bus.codec import FrameDecoder, FrameEncoder
from eps_hil.bus.commands import Kind, of_database
from eps_hil.bus.config import BusSetup
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import load_mapping
from eps_hil.bus.message_decoder import Sample
from eps_hil.bus.port import Port, open_port
from eps_hil.bus.record import LogFile
from eps_hil.errors import BusError, InputError
from eps_hil.physics.model import Model
from eps_hil.programme.cell_record import MEASURED
from eps_hil.programme.conductor import TICK_S, Reading, Wanted

COMMAND = "RIG_Command"
_SILENCE_S = 1.0
_FIRST_WAIT_S = 30.0
_RELEASE_FRAMES = 5
_LONGEST_STOP_S = 3.0
_ENABLE, _RELEASE = 1.0, 0.0


class Leader(Protocol):
    """What says, 100 times a second, what the rig shall do."""

    @property
    def over(self) -> bool:
        """Whether nothing more will happen."""

    def step(self, reading: Reading) -> Wanted:
        """Take what was read over the last tick, and say what the rig shall do."""


OnSamples = Callable[[list[Sample]], None]
BetweenTicks = Callable[[], OnSamples | None]
"""Called before each tick: raises where somebody stopped; says who takes that tick's samples."""


class Rig(Protocol):
    """A rig that can be led: on the bus, or simulated."""

    def lead(self, leader: Leader, log: LogFile | None, before_tick: BetweenTicks) -> None:
        """Until the leader is over; every frame goes to ``log``."""


def command_values(wanted: Wanted, model: Model, request: float = _ENABLE) -> dict[str, float]:
    """The signals of a command: speed of the wheel, preload, and no torque of the motor."""
    return {
        "WheelSpeedSetPoint": wanted.speed_rad_s * model.sensor_to_rotor,
        "RackForceSetPoint": wanted.force_n,
        "MotorShare": 0.0,  # a torque of the motor is an armed override's to command
        "CommandRequest": request,
    }


class Readings:
    """Means of what came in since the last tick; what brought nothing new stays as it was."""

    def __init__(self, position: str, model: Model) -> None:
        self._position, self._model = position, model
        self._latest: dict[str, float] = {}
        self._sums: dict[str, list[float]] = {}

    @property
    def heard(self) -> set[str]:
        """Signals that have been heard."""
        return set(self._latest)

    def take(self, samples: list[Sample]) -> None:
        """Samples of this tick; those known to be bad are left out."""
        for name, _, value in samples:
            if math.isfinite(value):
                self._sums.setdefault(name, []).append(value)

    def now(self) -> Reading:
        """The means, and the next tick begins."""
        for name, values in self._sums.items():
            self._latest[name] = sum(values) / len(values)
        self._sums.clear()
        position = self._latest.get(self._position, 0.0)
        if self._position == "motor_angle_rad":
            position /= self._model.rack_to_rotor_ratio_rad_per_m
        names = ("motor_speed_rad_s", "rack_force_n", "torque_sensor_nm", "motor_torque_nm")
        speed, force, sensor, motor = (self._latest.get(name, 0.0) for name in names)
        return Reading(speed, position, force, sensor, motor)


class RigLink:
    """The rig on the bus. Checked when made; :meth:`open` opens the port, :meth:`let_go` ends."""

    def __init__(self, setup: BusSetup, model: Model) -> None:
        mapping = load_mapping(setup.signals)
        database = load_database(setup.dbc, strict=mapping.strict)
        dbc_file = ", ".join(path.name for path in setup.dbc)
        self._model = model
        self._position = position_signal(setup, mapping.signals)
        self._decoder = FrameDecoder(
            database, mapping, mapping_file=setup.signals, dbc_file=dbc_file
        )
        self._encoder = FrameEncoder(database, COMMAND, dbc_file=dbc_file)
        commands = of_database(database, marked=mapping.commands)
        self._torque_ids = [i for i, one in commands.items() if one.kind is Kind.TORQUE]
        self._readings = Readings(self._position, model)
        self._log: LogFile | None = None
        self._heard_s = 0.0
        self._commanded = False
        self._bus = setup.bus
        self._port: Port

    def open(self, stop: Callable[[], bool], stopped: Callable[[], Exception]) -> None:
        """Open the port and wait until every signal that is needed has been heard.

        :class:`BusError` when the rig is silent or somebody else commands it; what ``stopped``
        makes is raised after ``stop()``.
        """
        bus = self._bus
        self._readings = Readings(self._position, self._model)
        self._commanded = False
        self._port = open_port(
            bus.interface,
            bus.channel,
            fd=bus.fd,
            send_ids=(self._encoder.can_id,),
            never_send_ids=self._torque_ids,
            options=bus.options,
        )
        try:
            self._wait_for_the_rig(stop, stopped)
        except BaseException:
            self.let_go()
            raise

    def lead(self, leader: Leader, log: LogFile | None, before_tick: BetweenTicks) -> None:
        """Ticks until the leader is over."""
        self._log = log
        try:
            deadline_s = time.monotonic()
            while not leader.over:
                sink = before_tick()
                deadline_s += TICK_S
                self._receive_until(deadline_s, sink)
                self.send(leader.step(self._readings.now()))
        finally:
            self._log = None

    @property
    def lost(self) -> int:
        """Frames that are known to be lost."""
        return self._decoder.faults["lost_frames"] + self._port.counts.lost_in_kernel

    def send(self, wanted: Wanted, request: float = _ENABLE) -> None:
        """One command."""
        self._commanded = True
        frame = self._encoder.frame(command_values(wanted, self._model, request))
        if self._port.send(frame) and self._log is not None:
            self._log.write([replace(frame, t_ns=time.time_ns())])

    def let_go(self) -> None:
        """Speed and preload to zero, then release, if we ever commanded anything.

        A bus that is gone leaves it to the rig.
        """
        try:
            end_s = time.monotonic() + _LONGEST_STOP_S
            while self._commanded and time.monotonic() < end_s:
                self.send(Wanted(0.0, 0.0))
                self._receive_until(time.monotonic() + TICK_S, None)
                now = self._readings.now()
                if abs(now.speed_rad_s) < 1.0 and abs(now.force_n) < 50.0:
                    break
            for _ in range(_RELEASE_FRAMES if self._commanded else 0):
                self.send(Wanted(0.0, 0.0), _RELEASE)
        except BusError:
            pass
        finally:
            self._port.close()

    def _receive_until(self, deadline_s: float, sink: OnSamples | None) -> None:
        """Take frames until the deadline; at least once, however late it is."""
        while True:
            frames = self._port.recv(max(deadline_s - time.monotonic(), 0.0))
            now_s = time.monotonic()
            if self._log is not None:
                self._log.write(frames)
            self._take(frames, sink, now_s)
            if now_s >= deadline_s:
                break
        if now_s - self._heard_s > _SILENCE_S:
            raise BusError(f"{self._port.name}: the rig has been silent for {_SILENCE_S:g} s")

    def _take(self, frames: Sequence[Frame], sink: OnSamples | None, now_s: float) -> None:
        for frame in frames:
            if frame.can_id == self._encoder.can_id and not frame.own and not frame.error:
                can_id = f"0x{frame.can_id:X}"
                raise BusError(f"{self._port.name}: another transmitter sends {COMMAND} ({can_id})")
            samples = self._decoder.decode(frame)
            if not samples:
                continue
            self._heard_s = now_s
            if sink is not None:
                sink(samples)
            self._readings.take(samples)

    def _wait_for_the_rig(self, stop: Callable[[], bool], stopped: Callable[[], Exception]) -> None:
        """Until every signal that is needed has been heard."""
        needed = {*MEASURED, self._position}
        end_s = time.monotonic() + _FIRST_WAIT_S
        while needed - self._readings.heard:
            if stop():
                raise stopped()
            self._heard_s = time.monotonic()
            if self._heard_s > end_s:
                missing = ", ".join(sorted(needed - self._readings.heard))
                raise BusError(f"{self._port.name}: nothing heard of {missing}; does the rig run?")
            self._receive_until(self._heard_s + 0.05, None)
            self._readings.now()


def position_signal(setup: BusSetup, signals: object) -> str:
    """Rack position, or the rotor's angle in its place; all other signals must be mapped too."""
    mapped = set(signals)  # type: ignore[call-overload]
    for name in MEASURED:
        if name not in mapped:
            raise InputError(setup.signals, name, "is not mapped; leading a rig needs it", "map it")
    for name in ("rack_position_m", "motor_angle_rad"):
        if name in mapped:
            return name
    problem = "neither it nor motor_angle_rad is mapped, and a rig is led by where its rack is"
    raise InputError(setup.signals, "rack_position_m", problem, "map one of them")
