"""Faults that may befall an override session: on the bus, in the process, in ECU, driver and gear.

Each is made on a running :class:`Lockstep`, with random size. tests/service/fault_cases.py runs and
judges them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState
from eps_hil.physics.chain import HAND_TORQUE, LOAD_FORCE
from eps_hil.rig.config import RigSetup, load_rig_setup
from eps_hil.rig.ecu import OverrideState
from eps_hil.rig.sensors import REPORTED
from eps_hil.service.config import ServiceConfig, load_config
from eps_hil.service.limits import Limits

from .lockstep import CONFIG, ROOT, Lockstep

TIGHT = {"max_input_age_s": 0.008, "max_frame_gap_s": 0.009, "heartbeat_timeout_s": 0.1} | {
    f"{name}_frozen_s": 0.012
    for name in ("motor_torque", "torque_sensor", "motor_speed", "rack_position")
}
"""Detection times of the campaign: shorter than the ECU's time-out, as docs/safety.md asks."""
INPUTS = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "rack_position_m")
IDS = (0x100, 0x101, 0x110)

Random = np.random.Generator


@dataclass
class Fault:
    """``begun``: whether what is wrong can be seen yet (a hand needs time to build up torque);
    ``heal``: make it good; ``must_stop``: False where going on within the limits is right too;
    ``foreign``: torque on the bus that is not the session's."""

    heal: Callable[[], None] = lambda: None
    begun: Callable[[], bool] = lambda: True
    must_stop: bool = True
    foreign: bool = False


Make = Callable[[Lockstep, Random], Fault]


def _heals(bench: Lockstep) -> Callable[[], None]:
    def heal() -> None:
        bench.spoil = bench.spoil_commands = lambda frames: frames
        bench.accepts = lambda: True

    return heal


def bus_silent(bench: Lockstep, random: Random) -> Fault:
    bench.spoil = lambda frames: []
    return Fault(_heals(bench))


def message_lost(bench: Lockstep, random: Random) -> Fault:
    gone = int(random.choice(IDS))
    bench.spoil = lambda frames: [f for f in frames if f.can_id != gone]
    return Fault(_heals(bench))


def single_frames_lost(bench: Lockstep, random: Random) -> Fault:
    bench.spoil = lambda frames: [f for f in frames if random.random() > 0.01]
    return Fault(_heals(bench), must_stop=False)


def message_corrupt(bench: Lockstep, random: Random) -> Fault:
    hit = int(random.choice(IDS))
    bench.spoil = lambda frames: [_flip(f, random) if f.can_id == hit else f for f in frames]
    return Fault(_heals(bench))


def _flip(frame: Frame, random: Random) -> Frame:
    data = bytearray(frame.data)
    data[int(random.integers(len(data)))] ^= 1 << int(random.integers(8))
    return replace(frame, data=bytes(data))


def frames_late(bench: Lockstep, random: Random) -> Fault:
    late: list[tuple[int, Frame]] = []
    delay = int(random.integers(10, 60))

    def spoil(frames: list[Frame]) -> list[Frame]:
        late.extend((bench.ms + delay, f) for f in frames)
        due = [f for ms, f in late if ms <= bench.ms]
        late[:] = [(ms, f) for ms, f in late if ms > bench.ms]
        return due

    bench.spoil = spoil
    return Fault(_heals(bench))


def message_repeated(bench: Lockstep, random: Random) -> Fault:
    """A gateway that goes on sending the last frame it got, stamped afresh."""
    stuck, kept = int(random.choice(IDS)), dict[int, Frame]()

    def spoil(frames: list[Frame]) -> list[Frame]:
        return [
            replace(kept.setdefault(f.can_id, f), t_ns=f.t_ns) if f.can_id == stuck else f
            for f in frames
        ]

    bench.spoil = spoil
    return Fault(_heals(bench))


def frames_doubled(bench: Lockstep, random: Random) -> Fault:
    bench.spoil = lambda frames: [f for f in frames for _ in range(1 + (random.random() < 0.3))]
    return Fault(_heals(bench), must_stop=False)


def second_transmitter(bench: Lockstep, random: Random) -> Fault:
    encoder = FrameEncoder(_dbc(), "EPSHIL_TorqueOverride")
    for _ in range(int(random.integers(256))):
        encoder.encode({})
    torque_nm, last_ms = float(random.uniform(-0.3, 0.3)), bench.ms + int(random.integers(1, 8))

    def spoil(frames: list[Frame]) -> list[Frame]:
        if bench.ms >= last_ms:
            return frames
        values = {"RequestedMotorTorque": torque_nm, "OverrideRequest": 1.0}
        frame = encoder.frame(values, bench.wall_ns)
        bench.rig.hear(frame, bench.now_ns)
        return [*frames, frame]

    bench.spoil = spoil
    return Fault(_heals(bench), begun=lambda: bench.ms >= last_ms, foreign=True)


def _tamper(bench: Lockstep, change: Callable[[np.ndarray], None]) -> Callable[[], None]:
    """Change what the sensors report; returns how to undo it."""
    sensors = bench.rig._sensors
    honest = sensors.step

    def step(truth: np.ndarray, out: np.ndarray) -> None:
        honest(truth, out)
        change(out)

    sensors.step = step  # type: ignore[method-assign]

    def undo() -> None:
        sensors.step = honest  # type: ignore[method-assign]

    return undo


def not_available(bench: Lockstep, random: Random) -> Fault:
    place = REPORTED.index(str(random.choice(INPUTS)))

    def change(out: np.ndarray) -> None:
        out[place] = math.nan

    return Fault(_tamper(bench, change))


def sensor_frozen(bench: Lockstep, random: Random) -> Fault:
    place, kept = REPORTED.index(str(random.choice(INPUTS))), []

    def change(out: np.ndarray) -> None:
        kept.append(float(out[place]))
        out[place] = kept[0]

    return Fault(_tamper(bench, change))


def sensor_off_scale(bench: Lockstep, random: Random) -> Fault:
    name = str(random.choice(INPUTS))
    off = {"motor_torque_nm": 0.3, "torque_sensor_nm": 4.0, "motor_speed_rad_s": 40.0}
    place, sign = REPORTED.index(name), float(random.choice([-1, 1]))

    def change(out: np.ndarray) -> None:
        out[place] = sign * off.get(name, 0.03)

    return Fault(_tamper(bench, change))


def _beyond(bench: Lockstep, name: str, limit: float) -> Callable[[], bool]:
    return lambda: abs(bench.core.values[name]) > limit


def driver_grabs(bench: Lockstep, random: Random) -> Fault:
    table = bench.rig._plant._table
    table[:, HAND_TORQUE] = float(random.choice([-1, 1]) * random.uniform(4.0, 10.0))
    limit = tight_limits().max_driver_torque_nm
    turns, speed = _beyond(bench, "torque_sensor_nm", limit), _too_fast(bench)
    return Fault(lambda: _let_go(bench), begun=lambda: turns() or speed())


def rack_pushed(bench: Lockstep, random: Random) -> Fault:
    table = bench.rig._plant._table
    table[:, LOAD_FORCE] = float(random.choice([-1, 1]) * random.uniform(800.0, 3000.0))
    return Fault(lambda: _let_go(bench), begun=_too_fast(bench))


def _too_fast(bench: Lockstep) -> Callable[[], bool]:
    limits = tight_limits()
    speed = _beyond(bench, "motor_speed_rad_s", limits.max_motor_speed_rad_s)
    place = _beyond(bench, "rack_position_m", limits.rack_position_max_m)
    return lambda: speed() or place()


def _let_go(bench: Lockstep) -> None:
    bench.rig._plant._table[:, [HAND_TORQUE, LOAD_FORCE]] = 0.0


def process_killed(bench: Lockstep, random: Random) -> Fault:
    bench.dead = True
    return Fault()


def process_stopped(bench: Lockstep, random: Random) -> Fault:
    bench.running = False

    def go_on() -> None:
        bench.running = True

    return Fault(go_on)


def process_slow(bench: Lockstep, random: Random) -> Fault:
    """Stopped for 10 to 18 ms: too short for the ECU, too long for the guard."""
    bench.running = False
    end_ms = bench.ms + int(random.integers(10, 19))

    def spoil(frames: list[Frame]) -> list[Frame]:
        bench.running = bench.running or bench.ms >= end_ms
        return frames

    bench.spoil = spoil
    return Fault(_heals(bench))


def source_raises(bench: Lockstep, random: Random) -> Fault:
    def wish(_: float) -> float:
        raise ZeroDivisionError("a mistake in the source")

    bench.core._source.wish = wish  # type: ignore[attr-defined]
    return Fault()


def source_mad(bench: Lockstep, random: Random) -> Fault:
    wild = float(random.choice([math.nan, math.inf, -math.inf, 0.41, -5.0, 0.2, -0.2]))
    bench.core._source.wish = lambda _: wild  # type: ignore[attr-defined]
    return Fault()


def terminated(bench: Lockstep, random: Random) -> Fault:
    bench.send(bench.core.end(bench.now_ns, "SIGTERM", fault=True))
    bench.dead = True
    return Fault()


def wall_clock_set(bench: Lockstep, random: Random) -> Fault:
    bench.wall_jump_ns = round(float(random.choice([-1, 1]) * 10 ** random.uniform(-2, 4)) * 1e9)
    return Fault(must_stop=False)


def stamps_of_another_clock(bench: Lockstep, random: Random) -> Fault:
    shift = round(float(random.choice([-1, 1]) * 10 ** random.uniform(-1.5, 4)) * 1e9)
    bench.spoil = lambda frames: [replace(f, t_ns=f.t_ns + shift) for f in frames]
    return Fault(_heals(bench))


def bus_off(bench: Lockstep, random: Random) -> Fault:
    bench.core.on_bus(bench.now_ns, BusState.BUS_OFF)
    bench.spoil = bench.spoil_commands = lambda frames: []
    return Fault(_heals(bench))


def bus_lost(bench: Lockstep, random: Random) -> Fault:
    bench.core.on_bus(bench.now_ns, BusState.LOST)
    bench.send(bench.core.end(bench.now_ns, "lost", fault=True))
    bench.spoil_commands = lambda frames: []
    bench.dead = True
    return Fault()


def send_queue_full(bench: Lockstep, random: Random) -> Fault:
    left = [int(random.integers(1, 40))]

    def accepts() -> bool:
        left[0] -= 1
        return left[0] < 0

    bench.accepts = accepts
    return Fault(_heals(bench))


def error_frame(bench: Lockstep, random: Random) -> Fault:
    bench.waiting.append(Frame(bench.wall_ns, 0x40, b"", error=True))
    return Fault()


def kernel_lost_frames(bench: Lockstep, random: Random) -> Fault:
    bench.core.on_bus(bench.now_ns, BusState.ERROR_ACTIVE, int(random.integers(1, 100)))
    return Fault()


def commands_lost(bench: Lockstep, random: Random) -> Fault:
    bench.spoil_commands = lambda frames: []
    return Fault(_heals(bench))


def commands_corrupt(bench: Lockstep, random: Random) -> Fault:
    bench.spoil_commands = lambda frames: [_flip(f, random) for f in frames]
    return Fault(_heals(bench))


def ecu_deaf(bench: Lockstep, random: Random) -> Fault:
    """Takes no command any more, keeps the last one; its time-out still works."""
    override, honest = bench.rig.override, bench.rig.override.hear
    override.hear = lambda command, now_ns: None  # type: ignore[method-assign]

    def heal() -> None:
        override.hear = honest  # type: ignore[method-assign]

    return Fault(heal)


def ecu_refuses(bench: Lockstep, random: Random) -> Fault:
    """From now on every command is rejected: zero torque, and the status says so."""
    override, honest = bench.rig.override, bench.rig.override.torque_nm

    def refuse(now_ns: int) -> float | None:
        torque_nm = honest(now_ns)
        if override.state is OverrideState.ACTIVE:
            override.state = OverrideState.REJECTED
        return None if torque_nm is None else 0.0

    override.torque_nm = refuse  # type: ignore[method-assign]
    return Fault(lambda: setattr(override, "torque_nm", honest))


def ecu_wrong_torque(bench: Lockstep, random: Random) -> Fault:
    """The motor gets another torque than commanded: turned round, doubled, or with an offset."""
    override, honest = bench.rig.override, bench.rig.override.torque_nm
    gain = float(random.choice([-1.0, 2.5, 1.0]))
    offset_nm = float(random.choice([-1, 1]) * 0.15) if gain == 1.0 else 0.0

    def wrong(now_ns: int) -> float | None:
        torque_nm = honest(now_ns)
        engaged = torque_nm is not None and override.state is OverrideState.ACTIVE
        return gain * torque_nm + offset_nm if engaged and torque_nm is not None else torque_nm

    override.torque_nm = wrong  # type: ignore[method-assign]
    seen = tight_limits().max_torque_error_nm + 0.03  # noise, and the way of 10 ms

    def begun() -> bool:
        told_nm = bench.core.command.torque_nm
        return abs(bench.ticks[-1].applied_nm - told_nm) > seen

    return Fault(lambda: setattr(override, "torque_nm", honest), begun, foreign=True)


def hand_off_the_key(bench: Lockstep, random: Random) -> Fault:
    bench.beating = False
    end_ms = bench.ms + 100

    def hold_again() -> None:
        bench.beating = True

    return Fault(hold_again, begun=lambda: bench.ms >= end_ms - 10)


FAULTS: tuple[Make, ...] = (
    bus_silent, message_lost, single_frames_lost, message_corrupt, frames_late, message_repeated,
    frames_doubled, second_transmitter, not_available, sensor_frozen, sensor_off_scale,
    driver_grabs, rack_pushed, process_killed, process_stopped, process_slow, source_raises,
    source_mad, terminated, wall_clock_set, stamps_of_another_clock, bus_off, bus_lost,
    send_queue_full, error_frame, kernel_lost_frames, commands_lost, commands_corrupt, ecu_deaf,
    ecu_refuses, ecu_wrong_torque, hand_off_the_key,
)  # fmt: skip


@cache
def _dbc() -> object:
    return load_database([ROOT / "dbc" / "eps_rig.dbc"])


@cache
def setup_for(manoeuvre: str) -> RigSetup:
    return load_rig_setup(CONFIG, manoeuvre)


@cache
def tight_config() -> ServiceConfig:
    config = load_config(CONFIG)
    assert config.override is not None
    limits = replace(config.override.limits, **TIGHT)
    return replace(config, override=replace(config.override, limits=limits))


def tight_limits() -> Limits:
    override = tight_config().override
    assert override is not None
    return override.limits
