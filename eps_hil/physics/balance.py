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
from eps_hil.physics.effects.effect import Instant
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
    out = np.empty((len(motion.time_s), 2))
    drive = drive_of(model)
    _balance(drive, added.in_use(drive.effects), motion, out)
    return out[:, 0], out[:, 1]


@njit
def _balance(drive: Drive, use: added.InUse, m: Motion, out: Floats) -> None:
    law = drive.law
    bristle = 0.0
    step = m.time_s[1] - m.time_s[0] if len(m.time_s) > 1 else 1e-3
    for k in range(len(m.time_s)):
        speed, force = m.speed_rad_s[k], m.rack_force_n[k]
        motor, sensor, more = m.motor_torque_nm[k], m.torque_sensor_nm[k], 0.0
        direction = speed if speed != 0.0 else m.travel_rad[k]
        if direction == 0.0:
            direction = bristle
        level = static_level_nm(direction, force, law)
        if use.any:  # a call for every slot and sample is most of the time, so only where needed
            u = Instant(
                m.time_s[k],
                speed,
                m.angle_rad[k],
                m.position_m[k],
                force,
                m.angle_rad[k] * drive.sensor_to_rotor,
                motor,
                sensor,
            )
            if use.motor:
                motor = added.motor_nm(drive.effects, u, motor)
            if use.sensor:
                sensor = added.sensor_nm(drive.effects, u, sensor)
            if use.level:
                level = max(added.level_nm(drive.effects, u, level), SMALLEST_LEVEL_NM)
            if use.torque:
                more = added.torque_nm(drive.effects, u, 0.0)
            if use.memory:  # a resting rotor still creeps, and what remembers rest wants to know
                creep = speed if speed != 0.0 else m.travel_rad[k] / step
                crept = Instant(u[0], creep, u[2], u[3], u[4], u[5], u[6], u[7])
                added.advance(drive.effects, crept, step)
        bristle = bristle_step(
            bristle, m.travel_rad[k], m.slip_rad[k], level, law.sigma0_nm_per_rad
        )
        friction = friction_torque_nm(bristle, speed, level, law) + more
        drive_torque = motor + drive.sensor_to_rotor * sensor - force / drive.ratio
        out[k, 0] = drive_torque - drive.inertia * m.acceleration_rad_s2[k] - friction
        out[k, 1] = friction + force / drive.ratio
