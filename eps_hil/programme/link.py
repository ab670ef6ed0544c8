"""The one way to a rig's set-points: one port, ``RIG_Command`` alone, zero and release at its end.

Whatever leads a rig (a programme's cells, an investigation's experiments) is stepped from here:
receive, write to the log, decode, and every 10 ms a command. Nothing is caught up: a tick that is
late moves those after it, or ends the run. When it ends, however it ends, speed and preload go to
zero and the rig is released, whatever else fails meanwhile; when it is killed, the rig's own
time-out does that.
"""

import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from eps_hil.bus.codec import FrameDecoder, FrameEncoder
from eps_hil.bus.commands import Kind, of_database
from eps_hil.bus.config import BusSetup
from eps_hil.bus.database import find_message, load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.live_senders import LISTEN_S
from eps_hil.bus.mapping import load_mapping
from eps_hil.bus.message_decoder import Sample
from eps_hil.bus.port import Port, open_port
from eps_hil.bus.record import LogFile
from eps_hil.errors import BusError, InputError, SafetyStop
from eps_hil.physics.model import Model
from eps_hil.programme.cell_record import MEASURED
from eps_hil.programme.conductor import TICK_S, Reading, Wanted
from eps_hil.programme.follows import Follows
from eps_hil.programme.set_points import check_set_points

COMMAND = "RIG_Command"
_FIRST_WAIT_S = 30.0
_RELEASE_FRAMES, _RELEASE_TRIES = 5, 50
_LONGEST_STOP_S = 3.0
"""As long as the reference rig needs from its largest preload, 10 kN at 4 kN/s."""
_LATE_S = 0.05
"""A command that is later ends the run: the rig may be about to stop by itself (0.1 s)."""
_LONGEST_PAUSE_S = 1.0
"""Between two leaders, at rest, while files are closed: an fsync may take so long."""
_REFUSED_S = 0.05
"""Without a set-point that the bus took: half of the rig's own time-out."""
_ENABLE, _RELEASE = 1.0, 0.0
_NOTHING = Wanted(0.0, 0.0)
_REST_RAD_S, _REST_N = 1.0, 50.0

STALE_S = 0.05
"""How old the newest good sample of a signal may be: half of the rig's own time-out of 0.1 s, and
3 rad of rotor (1.2 mm of rack) at the fastest set-point, 60 rad/s."""
_STALE_CYCLES = 3
"""The same for a slower message, in its cycles: two may be lost in a row."""
_SLOWEST_CYCLE_S = 0.05
"""A slower signal neither fills a pass of a second (20 samples) nor holds a limit."""


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


def _now_s() -> float:
    """A steady clock that goes on while the computer is suspended: the rig does, too."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def command_values(wanted: Wanted, model: Model, request: float = _ENABLE) -> dict[str, float]:
    """The signals of a command: speed of the wheel, preload, and no torque of the motor."""
    return {
        "WheelSpeedSetPoint": wanted.speed_rad_s * model.sensor_to_rotor,
        "RackForceSetPoint": wanted.force_n,
        "MotorShare": 0.0,  # a torque of the motor is an armed override's to command
        "CommandRequest": request,
    }


def _tried(most: Wanted) -> list[tuple[Wanted, float]]:
    """Set-points and requests that stand for all that will be sent."""
    speed, force = most
    return [
        (_NOTHING, _RELEASE), (_NOTHING, _ENABLE), (most, _ENABLE),
        (Wanted(-speed, -force), _ENABLE), (Wanted(speed / 3, -force / 7), _ENABLE),
    ]  # fmt: skip


class Readings:
    """Means of each signal's samples since the last tick; without a new one the last mean is kept.

    A kept mean leads nobody: :meth:`check` refuses it from :data:`STALE_S` on, or from three
    cycles of a slower message (``period_s``, by signal). Times in seconds of any steady clock.
    """

    def __init__(self, position: str, model: Model, period_s: Mapping[str, float]) -> None:
        self._position, self._model = position, model
        self._latest: dict[str, float] = {}
        self._sums: dict[str, list[float]] = {}
        self._heard_s: dict[str, float] = {}
        self._may_be_s = {
            name: max(STALE_S, _STALE_CYCLES * period_s.get(name, 0.0))
            for name in (*MEASURED, position)
        }

    @property
    def missing(self) -> list[str]:
        """Signals that are needed and were never heard."""
        return sorted(set(self._may_be_s) - set(self._heard_s))

    def take(self, samples: list[Sample], now_s: float) -> None:
        """Samples of this tick; those known to be bad are left out."""
        for name, _, value in samples:
            if math.isfinite(value):
                self._sums.setdefault(name, []).append(value)
                self._heard_s[name] = now_s

    def stale(self, now_s: float) -> list[str]:
        """Signals that are needed and have had no good sample for too long."""
        return [
            name
            for name, most_s in self._may_be_s.items()
            if now_s - self._heard_s.get(name, -math.inf) > most_s
        ]

    def check(self, now_s: float) -> None:
        """:class:`SafetyStop` where a signal is stale: whoever leads would not see a limit."""
        stale = self.stale(now_s)
        if stale:
            most_ms = 1e3 * max(self._may_be_s[name] for name in stale)
            raise SafetyStop(
                f"no good value of {', '.join(stale)} for {most_ms:.0f} ms: a rig is not led by "
                "old values"
            )

    def at_rest(self, now_s: float) -> bool:
        """Whether the rig turns slowly and carries next to no load, by values that are not old.

        Call it in place of :meth:`now`.
        """
        now = self.now()
        still = abs(now.speed_rad_s) < _REST_RAD_S and abs(now.force_n) < _REST_N
        return still and not self.stale(now_s)

    def now(self) -> Reading:
        """The means, and the next tick begins."""
        for name, values in self._sums.items():
            self._latest[name] = sum(values) / len(values)
        self._sums.clear()
        position = self._latest.get(self._position, math.nan)
        if self._position == "motor_angle_rad":
            position /= self._model.rack_to_rotor_ratio_rad_per_m
        names = ("motor_speed_rad_s", "rack_force_n", "torque_sensor_nm", "motor_torque_nm")
        speed, force, sensor, motor = (self._latest.get(name, math.nan) for name in names)
        return Reading(speed, position, force, sensor, motor)


class RigLink:
    """The rig on the bus. Checked when made; :meth:`open` opens the port, :meth:`let_go` ends.

    ``most``: the largest set-points that will be asked for, which the database must carry.
    """

    def __init__(self, setup: BusSetup, model: Model, most: Wanted = _NOTHING) -> None:
        mapping = load_mapping(setup.signals)
        database = load_database(setup.dbc, strict=mapping.strict)
        dbc_file = ", ".join(path.name for path in setup.dbc)
        self._model = model
        self._position = position_signal(setup, mapping.signals)
        self._decoder = FrameDecoder(
            database, mapping, mapping_file=setup.signals, dbc_file=dbc_file
        )
        self._encoder = FrameEncoder(database, COMMAND, dbc_file=dbc_file)
        check_set_points(
            find_message(database, COMMAND),
            FrameEncoder(database, COMMAND, dbc_file=dbc_file).frame,
            [command_values(one, model, request) for one, request in _tried(most)],
            dbc_file,
        )
        commands = of_database(database, marked=mapping.commands)
        self._torque_ids = [i for i, one in commands.items() if one.kind is Kind.TORQUE]
        check_cycles(setup, self._position, self._decoder.period_s)
        self._readings = self._nothing_heard()
        self._log: LogFile | None = None
        self._enabled = False
        self._sent_s = 0.0
        self.refused = 0
        """Set-points that a full send queue refused."""
        self._bus = setup.bus
        self._port: Port

    def open(self, stop: Callable[[], bool], stopped: Callable[[], Exception]) -> None:
        """Open the port, wait until every signal that is needed has been heard, and release.

        A rig that a program left without a release obeys nothing until it gets one.
        :class:`BusError` when the rig is silent or somebody else commands it; what ``stopped``
        makes is raised after ``stop()``.
        """
        bus = self._bus
        self._readings = self._nothing_heard()
        self._enabled = False
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
            self._release()
        except BaseException:
            self.let_go()
            raise

    def _nothing_heard(self) -> Readings:
        return Readings(self._position, self._model, self._decoder.period_s)

    def lead(self, leader: Leader, log: LogFile | None, before_tick: BetweenTicks) -> None:
        """Ticks until the leader is over.

        :class:`SafetyStop` where a signal that is needed has been silent or bad for too long, the
        rack position does not follow the rotor, the bus takes no set-point, or this process was
        late (:data:`_LATE_S`). Whatever is raised, the rig is at rest and released before.
        """
        self._log, follows = log, Follows(self._model.rack_to_rotor_ratio_rad_per_m)
        try:
            self._take_up_again()
            deadline_s = self._sent_s = _now_s()
            while not leader.over:
                sink = before_tick()
                deadline_s += TICK_S
                self._receive_until(deadline_s, sink)
                self._readings.check(now_s := _now_s())
                reading = self._readings.now()
                follows.check(reading, now_s)
                wanted = leader.step(reading)
                late_s = _now_s() - deadline_s
                if late_s > _LATE_S:
                    raise SafetyStop(
                        f"this process stood still for {late_s:.3g} s: a set-point that is more "
                        f"than {1e3 * _LATE_S:.0f} ms late is not sent"
                    )
                if late_s > TICK_S:
                    deadline_s += late_s
                taken = self.send(wanted)
                if not taken and _now_s() - self._sent_s > _REFUSED_S:
                    raise SafetyStop(
                        f"{self._port.name}: no set-point has been taken for "
                        f"{1e3 * _REFUSED_S:.0f} ms: the send queue is full"
                    )
        except BaseException:
            self._log = None  # its disk may be what failed, or take a second to close
            self.stop()
            raise
        finally:
            self._log = None

    def _take_up_again(self) -> None:
        """Where files took so long that the rig may have timed out: to rest, released, anew."""
        pause_s = _now_s() - self._sent_s
        if not self._enabled or pause_s <= _LATE_S:
            return
        if pause_s > _LONGEST_PAUSE_S:
            raise SafetyStop(f"no set-point was sent for {pause_s:.3g} s: this process stood still")
        self.stop()

    @property
    def lost(self) -> int:
        """Frames that are known to be lost."""
        return self._decoder.faults["lost_frames"] + self._port.counts.lost_in_kernel

    def send(self, wanted: Wanted, request: float = _ENABLE) -> bool:
        """One command; whether the bus took it (else it is counted in :attr:`refused`)."""
        self._enabled = self._enabled or request == _ENABLE
        frame = self._encoder.frame(command_values(wanted, self._model, request))
        if not self._port.send(frame):
            self.refused += 1
            return False
        self._sent_s = _now_s()
        if self._log is not None:
            self._log.write([replace(frame, t_ns=time.time_ns())])
        return True

    def let_go(self) -> None:
        """Speed and preload to zero, then release, if the rig is commanded; the port is closed.

        A bus that is gone leaves it to the rig.
        """
        try:
            self.stop()
        finally:
            self._port.close()

    def stop(self) -> None:
        """Speed and preload to zero, then release, if the rig is commanded; no error is raised.

        Zeros go out until it is at rest by values that are not old, for 3 s at most.
        """
        if not self._enabled:
            return
        end_s, zeros = _now_s() + _LONGEST_STOP_S, 0
        while _now_s() < end_s:
            zeros += self._tick_of_zero(_ENABLE)
            if zeros and self._readings.at_rest(_now_s()):
                break
        self._release()

    def _release(self) -> None:
        """Until the bus took as many as are sent at once in case some are lost."""
        releases = 0
        for _ in range(_RELEASE_TRIES):
            releases += self._tick_of_zero(_RELEASE)
            if releases == _RELEASE_FRAMES:
                break
        self._enabled = False

    def _tick_of_zero(self, request: float) -> bool:
        """One frame of zeros, whether the bus took it, and a tick's frames.

        What ended the leading (a silent bus, another transmitter, an error of our own) is still
        there: each part is tried by itself, and the next frame goes out all the same.
        """
        deadline_s, taken = _now_s() + TICK_S, False
        with contextlib.suppress(Exception):
            taken = self.send(Wanted(0.0, 0.0), request)
        with contextlib.suppress(Exception):
            self._receive_until(deadline_s, None)
        time.sleep(max(deadline_s - _now_s(), 0.0))
        return taken

    def _receive_until(self, deadline_s: float, sink: OnSamples | None) -> None:
        """Take frames until the deadline; at least once, however late it is."""
        while True:
            frames = self._port.recv(max(deadline_s - _now_s(), 0.0))
            now_s = _now_s()
            if self._log is not None:
                self._log.write(frames)
            self._take(frames, sink, now_s)
            if now_s >= deadline_s:
                break

    def _take(self, frames: Sequence[Frame], sink: OnSamples | None, now_s: float) -> None:
        foreign = False
        for frame in frames:
            if frame.own or frame.error or frame.remote:
                continue
            foreign |= frame.can_id == self._encoder.can_id
            samples = self._decoder.decode(frame)
            if not samples:
                continue
            if sink is not None:
                sink(samples)
            self._readings.take(samples, now_s)
        if foreign:
            can_id = f"0x{self._encoder.can_id:X}"
            raise BusError(f"{self._port.name}: another transmitter sends {COMMAND} ({can_id})")

    def _wait_for_the_rig(self, stop: Callable[[], bool], stopped: Callable[[], Exception]) -> None:
        """Until every signal that is needed has been heard, and nobody else who commands."""
        begun_s = _now_s()
        end_s = begun_s + _FIRST_WAIT_S
        while self._readings.missing or _now_s() - begun_s < LISTEN_S:
            if stop():
                raise stopped()
            now_s = _now_s()
            if now_s > end_s and self._readings.missing:
                missing = ", ".join(self._readings.missing)
                raise BusError(f"{self._port.name}: nothing heard of {missing}; does the rig run?")
            self._receive_until(now_s + 0.05, None)
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


def check_cycles(setup: BusSetup, position: str, period_s: Mapping[str, float]) -> None:
    """:class:`InputError` where a signal that leads a rig comes too seldom, by its own cycle."""
    for name in (*MEASURED, position):
        cycle_s = period_s.get(name, 0.0)
        if cycle_s > _SLOWEST_CYCLE_S:
            raise InputError(
                setup.signals, name,
                f"comes every {1e3 * cycle_s:g} ms, and a rig is led by signals of every "
                f"{1e3 * _SLOWEST_CYCLE_S:g} ms or faster", "have it sent faster",
            )  # fmt: skip
