"""Forward simulation of the 1-mass model (eq. 1c, 1d) under recorded torques and rack force.

Everything here is physical: instants, not stamps; sensor delays belong to who calls. Torques and
speeds are at the rotor, the rack force at the rack (signs: CONTRACT 1).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.physics.effects import added
from eps_hil.physics.effects.catalogue import joint_of, with_model_effects
from eps_hil.physics.effects.effect import Effect, Instant, Slot
from eps_hil.physics.friction import (
    SMALLEST_LEVEL_NM,
    FrictionLaw,
    bristle_step,
    friction_law,
    friction_torque_nm,
    static_level_nm,
)
from eps_hil.physics.model import Model

LONGEST_STEP_S = 5e-5

Floats = npt.NDArray[np.float64]


class Drive(NamedTuple):
    """The 1-mass model as compiled code takes it, effects included."""

    inertia: float
    ratio: float
    sensor_to_rotor: float
    law: FrictionLaw
    effects: added.Added
    use: added.InUse


@dataclass(frozen=True, slots=True)
class Motion:
    """What the model does, at the instants of its inputs; all shape (n,)."""

    speed_rad_s: Floats
    angle_rad: Floats
    friction_torque_nm: Floats
    rack_rad: Floats
    """i_APA times the rack's position: the angle itself unless the joint gives or has play."""


def drive_of(model: Model, only: Callable[[Effect, Slot], bool] | None = None) -> Drive:
    """The compiled form of a model; ``ValueError`` if one of its effects is wrong.

    ``only`` picks effects that act at run time (``added.added``).
    """
    worked_in = with_model_effects(model)
    effects = added.added(worked_in, only)
    return Drive(
        worked_in.inertia_kg_m2,
        worked_in.rack_to_rotor_ratio_rad_per_m,
        worked_in.sensor_to_rotor,
        friction_law(worked_in.friction),
        effects,
        added.in_use(effects),
    )


def rack_position_m(model: Model, rack_rad: Floats) -> Floats:
    """The rack's position, (n,), of an angle that is i_APA times it where the ratio is one."""
    rack = np.asarray(rack_rad, dtype=np.float64)
    drive = drive_of(model)
    position = rack / drive.ratio
    if drive.use.position:
        _positions(drive, rack, np.zeros(3), position)
    return position


def rotor_angle_rad(model: Model, rack_position_m: Floats) -> Floats:
    """The rotor's angle, (n,), of a rigid drive without play at a rack position; its inverse."""
    worked_in = with_model_effects(model)
    angle = worked_in.rack_to_rotor_ratio_rad_per_m * np.asarray(rack_position_m, dtype=np.float64)
    for entry in worked_in.effects:
        if entry["effect"] == "rack_ratio":
            slope, bend = entry["slope_per_m"], entry["bend_per_m2"]
            angle = angle * (1.0 + (slope + bend * rack_position_m) * rack_position_m)
    return angle


@kernel
def _positions(drive: Drive, rack_rad: Floats, nothing: Floats, position: Floats) -> None:
    for k in range(len(position)):
        position[k] = instant(drive, 0.0, 0.0, rack_rad[k], nothing).position_m


def simulate(
    model: Model,
    time_s: Floats,
    motor_torque_nm: Floats,
    torque_sensor_nm: Floats,
    rack_force_n: Floats,
    *,
    speed_rad_s: float = 0.0,
    angle_rad: float = 0.0,
    bristle_rad: float = 0.0,
    memory: Floats | None = None,
) -> Motion:
    """Run the model, effects included, from the given state; all arrays shape (n,).

    ``motor_torque_nm`` (rotor) and ``torque_sensor_nm`` (column) are what is reported, at its
    physical instants; ``time_s`` counts from the start of the recording (warm-up needs it). Inputs
    are straight lines between samples; each interval is cut into steps of 50 µs or less. What
    effects remember is ``memory`` (of :func:`memories`); without one, nothing has happened before.
    """
    inputs = np.column_stack([motor_torque_nm, torque_sensor_nm, rack_force_n])
    out = np.empty((len(time_s), 4))
    start = np.array([speed_rad_s, angle_rad, bristle_rad])
    joint, drive = joint_of(model), drive_of(model)
    if memory is not None:
        drive.effects.state[:] = memory
    if joint is None:
        _integrate(drive, time_s, inputs, start, np.empty(3), out)
        out[:, 3] = out[:, 1]
    else:
        from eps_hil.physics.two_masses import integrate

        integrate(drive, joint, time_s, inputs, start, np.empty(3), out)
    return Motion(out[:, 0], out[:, 1], out[:, 2], out[:, 3])


def memories(
    model: Model,
    time_s: Floats,
    inputs: Floats,
    speed_rad_s: Floats,
    angle_rad: Floats,
    firsts: Sequence[int],
) -> list[Floats | None]:
    """What effects remember at each sample of ``firsts`` of a measured motion, arrays (n,).

    ``inputs`` (n, 3): motor torque, torsion-bar torque, rack force, as :func:`simulate`. One way
    through the motion for all of them; None where a model remembers nothing.
    """
    drive = drive_of(model)
    if not drive.use.memory:
        return [None] * len(firsts)
    found: list[Floats | None] = [None] * len(firsts)
    at = 0
    for k in np.argsort(firsts, kind="stable").tolist():
        _remember(drive, time_s, speed_rad_s, angle_rad, inputs, at, firsts[k])
        at = firsts[k]
        found[k] = drive.effects.state.copy()
    return found


@kernel
def _remember(
    drive: Drive,
    time_s: Floats,
    speed: Floats,
    angle: Floats,
    inputs: Floats,
    first: int,
    last: int,
) -> None:
    """Moves what effects remember on along a measured motion, from one sample to another."""
    for k in range(first, last):
        u = instant(drive, time_s[k], speed[k], angle[k], inputs[k])
        added.advance(drive.effects, u, time_s[k + 1] - time_s[k])


@kernel
def instant(drive: Drive, t: float, speed: float, angle: float, row: Floats) -> Instant:
    """What a kernel is told; ``row``: motor torque, torsion-bar torque, rack force."""
    position = angle / drive.ratio
    pinion = angle * drive.sensor_to_rotor
    u = Instant(t, speed, angle, position, row[2], pinion, row[0], row[1], drive.ratio)
    if not drive.use.position:
        return u
    position = added.position_m(drive.effects, u, position)
    return Instant(t, speed, angle, position, row[2], pinion, row[0], row[1], drive.ratio)


@kernel
def motor_nm(drive: Drive, u: Instant) -> float:
    """Shaft torque of the motor from the reported one."""
    reported = u.motor_torque_nm
    return added.motor_nm(drive.effects, u, reported) if drive.use.motor else reported


@kernel
def sensor_nm(drive: Drive, u: Instant) -> float:
    """True torsion-bar torque from the reported one, at the column."""
    reported = u.torque_sensor_nm
    return added.sensor_nm(drive.effects, u, reported) if drive.use.sensor else reported


@kernel
def load_nm(drive: Drive, u: Instant) -> float:
    """What the rack force is at the rotor (Nm)."""
    load = u.rack_force_n / drive.ratio
    return added.load_nm(drive.effects, u, load) if drive.use.load else load


@kernel
def level_nm(drive: Drive, u: Instant) -> float:
    """T_fs (Nm) with what effects add to it."""
    level = static_level_nm(u.speed_rad_s, u.rack_force_n, drive.law)
    if drive.use.level:
        level = added.level_nm(drive.effects, u, level)
    return max(level, SMALLEST_LEVEL_NM)


@kernel
def friction_nm(drive: Drive, u: Instant, level: float, bristle: float, after: float) -> float:
    """Friction and added torque (Nm) with the bristle half way."""
    torque = friction_torque_nm(0.5 * (bristle + after), u.speed_rad_s, level, drive.law)
    return torque + added.torque_nm(drive.effects, u, 0.0) if drive.use.torque else torque


@kernel
def _integrate(
    drive: Drive, time_s: Floats, inputs: Floats, start: Floats, row: Floats, out: Floats
) -> None:
    """Into ``out`` (n, 4); ``row`` (3,) is for work."""
    speed, angle, bristle = start[0], start[1], start[2]
    for k in range(len(time_s)):
        u = instant(drive, time_s[k], speed, angle, inputs[k])
        out[k, 0], out[k, 1] = speed, angle
        out[k, 2] = friction_nm(drive, u, level_nm(drive, u), bristle, bristle)
        if k + 1 == len(time_s):
            break
        speed, angle, bristle = interval(
            drive,
            time_s[k],
            time_s[k + 1] - time_s[k],
            speed,
            angle,
            bristle,
            inputs[k],
            inputs[k + 1],
            row,
        )


@kernel
def interval(
    drive: Drive,
    start_s: float,
    length_s: float,
    speed: float,
    angle: float,
    bristle: float,
    before: Floats,
    after: Floats,
    row: Floats,
) -> tuple[float, float, float]:
    """Speed, angle and bristle after ``length_s``; inputs run straight from ``before`` to
    ``after`` (3,). ``row`` (3,) is for work."""
    steps = max(1, int(np.ceil(length_s / LONGEST_STEP_S - 1e-6)))
    dt = length_s / steps
    for j in range(steps):
        part = (j + 0.5) / steps
        for i in range(3):
            row[i] = before[i] + part * (after[i] - before[i])
        t = start_s + part * length_s
        middle, bristle = _middle(drive, t, speed, angle, bristle, row, dt)
        if drive.use.memory:
            u = instant(drive, t, middle, angle + 0.5 * dt * middle, row)
            added.advance(drive.effects, u, dt)
        angle += dt * middle
        speed = 2.0 * middle - speed
    return speed, angle, bristle


@kernel
def _middle(
    drive: Drive, t: float, speed: float, angle: float, bristle: float, row: Floats, dt: float
) -> tuple[float, float]:
    """Speed in the middle of a step (implicit midpoint rule) and the bristle at its end."""
    law = drive.law
    middle, after = speed, bristle
    # The friction's stiffness over the step makes the iteration contract at any speed.
    stiff = law.sigma1_nm_s_per_rad + 0.5 * dt * law.sigma0_nm_per_rad
    weight = drive.inertia / (0.5 * dt)
    for _ in range(4):
        u = instant(drive, t, middle, angle + 0.5 * dt * middle, row)
        hand = drive.sensor_to_rotor * sensor_nm(drive, u)
        push = motor_nm(drive, u) + hand - load_nm(drive, u)
        level = level_nm(drive, u)
        after = bristle_step(bristle, middle * dt, abs(middle) * dt, level, law.sigma0_nm_per_rad)
        friction = friction_nm(drive, u, level, bristle, after)
        middle = (weight * speed + push - friction + stiff * middle) / (weight + stiff)
    return middle, after
