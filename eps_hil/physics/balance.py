"""The torque balance of a measured motion: what the model says the torques must add up to.

The friction's bristle is a hidden state: it is simulated from the measured motion, and forgets its
start within one presliding length. Same functions as the simulator, so an effect written once acts
here too. Torques are at the rotor.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.physics.effects import added
from eps_hil.physics.friction import (
    SMALLEST_LEVEL_NM,
    bristle_step,
    friction_torque_nm,
    static_level_nm,
)
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import Drive, drive_of

Floats = npt.NDArray[np.float64]


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


def residual_nm(model: Model, motion: Motion) -> tuple[Floats, Floats]:
    """(what the torques are short of the balance, friction plus added torque), both (n,), Nm.

    Residual = T_1m − F/i_APA − J ω̇ − T_f − added torques; zero for the right model.
    """
    drive, out = drive_of(model), np.empty((len(motion.time_s), 2))
    use = added.in_use(drive.effects)
    # read-only arrays are another type: compiled anew, where they can be compiled at all
    motion = Motion(*(np.require(column, requirements="W") for column in motion))
    motor, sensor = motion.motor_torque_nm, motion.torque_sensor_nm
    motor = motor.copy() if use.motor else motor
    sensor = sensor.copy() if use.sensor else sensor
    more = np.zeros(len(out)) if use.torque else _NOTHING
    _balance(drive, use, motion, motor, sensor, more, out)
    return out[:, 0], out[:, 1]


_NOTHING = np.zeros(0)


@njit
def _balance(
    drive: Drive,
    use: added.InUse,
    m: Motion,
    motor: Floats,
    sensor: Floats,
    more: Floats,
    out: Floats,
) -> None:
    """``motor``, ``sensor``: as reported, changed in place by effects; ``more``: zeros, or empty
    where nothing adds torque.

    The slots' functions are called in here because compiled code out of the disk cache may call
    closures, and Python may not: there, each process would compile them again.
    """
    if use.motor:
        added.motor_along(drive.effects, m, drive.sensor_to_rotor, motor)
    if use.sensor:
        added.sensor_along(drive.effects, m, drive.sensor_to_rotor, sensor)
    if use.torque:
        added.torque_along(drive.effects, m, drive.sensor_to_rotor, more)
    law = drive.law
    bristle = 0.0
    step = m.time_s[1] - m.time_s[0] if len(m.time_s) > 1 else 1e-3
    for k in range(len(m.time_s)):
        speed, force = m.speed_rad_s[k], m.rack_force_n[k]
        direction = speed if speed != 0.0 else m.travel_rad[k]
        if direction == 0.0:
            direction = bristle
        level = static_level_nm(direction, force, law)
        if use.level:  # a call for every sample is most of the time, so only where needed
            u = added.instant(m, k, drive.sensor_to_rotor)
            level = max(added.level_nm(drive.effects, u, level), SMALLEST_LEVEL_NM)
            if use.memory:
                added.advance_levels(drive.effects, added.crept(m, k, u, step), step)
        bristle = bristle_step(
            bristle, m.travel_rad[k], m.slip_rad[k], level, law.sigma0_nm_per_rad
        )
        friction = friction_torque_nm(bristle, speed, level, law)
        if use.torque:
            friction += more[k]
        drive_torque = motor[k] + drive.sensor_to_rotor * sensor[k] - force / drive.ratio
        out[k, 0] = drive_torque - drive.inertia * m.acceleration_rad_s2[k] - friction
        out[k, 1] = friction + force / drive.ratio
