"""The torque balance of a measured motion: what the model says the torques must add up to.

The friction's bristle is a hidden state: it is simulated from the measured motion, and forgets its
start within one presliding length. Same functions as the simulator, so an effect written once acts
here too. Torques are at the rotor.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.physics.effects import added
from eps_hil.physics.effects.effect import Ratios
from eps_hil.physics.friction import (
    SMALLEST_LEVEL_NM,
    FrictionLaw,
    bristle_step,
    friction_torque_nm,
    static_level_nm,
)
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import Drive, drive_of

Floats = npt.NDArray[np.float64]
Key = tuple[Any, ...]
Once = Callable[[Key, bool, Callable[[], Floats]], Floats]


class Motion(NamedTuple):
    """A measured motion at equal steps of physical time, all shape (n,).

    ``speed_rad_s`` is zero where the rotor rests (noise would wear the bristle down);
    ``travel_rad`` and ``slip_rad`` are displacement and path since the step before;
    ``acceleration_rad_s2`` is unfiltered.
    """

    time_s: Floats
    motor_torque_nm: Floats
    torque_sensor_nm: Floats
    rack_force_n: Floats
    position_m: Floats
    speed_rad_s: Floats
    angle_rad: Floats
    travel_rad: Floats
    slip_rad: Floats
    acceleration_rad_s2: Floats


def _follows_from(drive: Drive) -> Key:
    """What of a model its friction along a given motion follows from."""
    if not drive.use.level:
        return (*drive.law,)
    rows = added.LEVEL_ROWS
    effects = drive.effects.terms[rows].tobytes(), drive.effects.parameters[rows].tobytes()
    return (*drive.law, drive.ratio, drive.sensor_to_rotor, *effects)


def residual_nm(
    model: Model,
    motion: Motion,
    rubbing_n: Floats | None = None,
    once: Once | None = None,
    driving_nm: Floats | None = None,
) -> tuple[Floats, Floats]:
    """(what the torques are short of the balance, friction plus added torque), both (n,), Nm.

    Residual = T_1m − F/i_APA − J ω̇ − T_f − added torques; zero for the right model.
    ``rubbing_n``: the rack force (n,) that friction grows with, where |F| is known with less noise.
    ``driving_nm``: likewise the motor torque (n,) that is the input of laws: a hysteresis operator
    keeps the peaks of noise. The torque that acts is that of ``motion``.
    ``once`` is handed what the friction follows from, whether more of the motion than speed and
    rack force is part of that, and how it is worked out; it may know the result.
    """
    drive, out = drive_of(model), np.empty((len(motion.time_s), 2))
    use = drive.use
    if not all(column.flags.writeable for column in motion):
        # read-only arrays are another type: compiled anew, where they can be compiled at all
        motion = Motion(*(np.require(column, requirements="W") for column in motion))
    motor, sensor = motion.motor_torque_nm, motion.torque_sensor_nm
    motor = motor.copy() if use.motor else motor
    sensor = sensor.copy() if use.sensor else sensor
    more = np.zeros(len(out)) if use.torque else _NOTHING
    load = motion.rack_force_n / drive.ratio
    if rubbing_n is not None:
        motion = motion._replace(rack_force_n=np.require(rubbing_n, requirements="W"))
    if driving_nm is not None:
        motion = motion._replace(motor_torque_nm=np.require(driving_nm, requirements="W"))

    def rubbed() -> Floats:
        friction = np.empty(len(out))
        levels = np.zeros((2, len(out))) if use.level else _NO_LEVELS
        _rub(drive, motion, levels, friction)
        return friction

    friction = rubbed() if once is None else once(_follows_from(drive), use.level, rubbed)
    _balance(drive, motion, motor, sensor, load, more, friction, out)
    return out[:, 0], out[:, 1]


def sliding_levels_nm(model: Model, motion: Motion) -> Floats:
    """T_fs (n,) of a motion in the direction of its speed, effects included, Nm at the rotor.

    Never below the least that the balance rubs with, whatever effects take off it.
    """
    drive, levels = drive_of(model), np.zeros((2, len(motion.time_s)))
    _levels_with_effects(drive, motion, levels)
    return np.maximum(levels[0], SMALLEST_LEVEL_NM)


def motor_torque_acting_nm(model: Model, motion: Motion) -> Floats:
    """What acts of the motor torque along a motion (n,), effects included, Nm."""
    drive, acting = drive_of(model), motion.motor_torque_nm.copy()
    _motor_with_effects(drive, motion, acting)
    return acting


@kernel
def _motor_with_effects(drive: Drive, m: Motion, motor: Floats) -> None:
    if drive.use.motor:
        added.motor_along(drive.effects, m, Ratios(drive.sensor_to_rotor, drive.ratio), motor)


@kernel
def _levels_with_effects(drive: Drive, m: Motion, levels: Floats) -> None:
    ratios = Ratios(drive.sensor_to_rotor, drive.ratio)
    _levels(m, drive.law, levels)
    if drive.use.level:
        added.levels_along(drive.effects, m, ratios, levels[0], levels[1])


_NOTHING, _NO_LEVELS = np.zeros(0), np.zeros((2, 0))
_BACKWARD = -1e-300
"""A direction without a speed."""


@kernel
def _rub(drive: Drive, m: Motion, levels: Floats, friction: Floats) -> None:
    """Friction along the motion; ``levels``: (2, n), or (2, 0) where nothing adds to eq. 3.

    The slots' functions are called in here because compiled code out of the disk cache may call
    closures, and Python may not: there, each process would compile them again.
    """
    law, use = drive.law, drive.use
    if use.level:
        ratios = Ratios(drive.sensor_to_rotor, drive.ratio)
        _levels(m, law, levels)
        added.levels_along(drive.effects, m, ratios, levels[0], levels[1])
    bristle = 0.0
    for k in range(len(friction)):
        speed, force = m.speed_rad_s[k], m.rack_force_n[k]
        direction = speed if speed != 0.0 else m.travel_rad[k]
        way = 0
        if direction == 0.0:
            direction = bristle
            way = 0 if bristle >= 0.0 else 1
        if use.level:  # a call for every sample would be most of the time
            level = max(levels[way, k], SMALLEST_LEVEL_NM)
        else:
            level = static_level_nm(direction, force, law)
        bristle = bristle_step(
            bristle, m.travel_rad[k], m.slip_rad[k], level, law.sigma0_nm_per_rad
        )
        friction[k] = friction_torque_nm(bristle, speed, level, law)


@kernel
def _balance(
    drive: Drive,
    m: Motion,
    motor: Floats,
    sensor: Floats,
    load: Floats,
    more: Floats,
    friction: Floats,
    out: Floats,
) -> None:
    """``motor``, ``sensor``, F/i_APA: as reported, changed in place by effects; ``more``: zeros, or
    empty where nothing adds torque.
    """
    use, ratios = drive.use, Ratios(drive.sensor_to_rotor, drive.ratio)
    if use.motor:
        added.motor_along(drive.effects, m, ratios, motor)
    if use.sensor:
        added.sensor_along(drive.effects, m, ratios, sensor)
    if use.load:
        added.load_along(drive.effects, m, ratios, load)
    if use.torque:
        added.torque_along(drive.effects, m, ratios, more)
    for k in range(len(friction)):
        torque = friction[k]
        if use.torque:
            torque += more[k]
        drive_torque = motor[k] + drive.sensor_to_rotor * sensor[k] - load[k]
        out[k, 0] = drive_torque - drive.inertia * m.acceleration_rad_s2[k] - torque
        out[k, 1] = torque + load[k]


@kernel
def _levels(m: Motion, law: FrictionLaw, levels: Floats) -> None:
    """Eq. 3 along the motion; the second row for the other way, where nothing says which."""
    for k in range(len(m.time_s)):
        speed = m.speed_rad_s[k]
        direction = speed if speed != 0.0 else m.travel_rad[k]
        levels[0, k] = static_level_nm(direction, m.rack_force_n[k], law)
        if direction == 0.0:
            levels[1, k] = static_level_nm(_BACKWARD, m.rack_force_n[k], law)
