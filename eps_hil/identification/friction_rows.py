"""Friction of a measured motion together with its sensitivities, in one compiled pass.

The bristle (eq. 2a, exact over a step) and its derivatives obey the same recursion, so they are
simulated side by side: nine parameters for about the price of two runs of the balance.
"""

import math

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.physics.balance import Motion, residual_nm
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

COLUMNS = (
    "friction.offset_pos_nm",
    "friction.offset_neg_nm",
    "friction.viscous_pos_nm_s_per_rad",
    "friction.viscous_neg_nm_s_per_rad",
    "friction.load_pos_nm_per_n",
    "friction.load_neg_nm_per_n",
    "friction.sigma0_nm_per_rad",
    "friction.sigma1_nm_s_per_rad",
    "friction.sigma1_speed_rad_s",
)
"""Rows 1 to 9 of the result, d residual / d parameter; row 0 is the residual itself."""


def friction_rows(model: Model, motion: Motion) -> Floats:
    """(10, n): drive torque less friction and added torque (J ω̇ not taken off), and sensitivities.

    Same functions as ``physics.balance``; with an effect inside T_fs the sensitivities are those
    of the level without it.
    """
    out = np.empty((1 + len(COLUMNS), len(motion.time_s)))
    drive = drive_of(model)
    _rows(drive, motion, bool(model.effects), out)
    return out


def residual(model: Model, motion: Motion) -> Floats:
    """The first of the rows alone, (n,)."""
    drive = drive_of(model)
    if model.effects:
        left, _ = residual_nm(model, motion)
        return left + drive.inertia * motion.acceleration_rad_s2
    out = np.empty(len(motion.time_s))
    _plain(drive, motion, out)
    return out


@njit
def _plain(drive: Drive, m: Motion, out: Floats) -> None:
    """The balance of a model without added effects: what is evaluated most."""
    law, z = drive.law, 0.0
    for k in range(len(m.time_s)):
        speed, force = m.speed_rad_s[k], m.rack_force_n[k]
        direction = speed if speed != 0.0 else m.travel_rad[k]
        if direction == 0.0:
            direction = z
        level = static_level_nm(direction, force, law)
        z = bristle_step(z, m.travel_rad[k], m.slip_rad[k], level, law.sigma0_nm_per_rad)
        drive_torque = m.motor_torque_nm[k] + drive.sensor_to_rotor * m.torque_sensor_nm[k]
        friction = friction_torque_nm(z, speed, level, law)
        out[k] = drive_torque - force / drive.ratio - friction


@njit
def _rows(drive: Drive, m: Motion, busy: bool, out: Floats) -> None:
    law = drive.law
    s0 = law.sigma0_nm_per_rad
    z = 0.0
    dz = np.zeros(7)
    dlevel = np.zeros(6)
    step = m.time_s[1] - m.time_s[0] if len(m.time_s) > 1 else 1e-3
    for k in range(len(m.time_s)):
        speed, force = m.speed_rad_s[k], m.rack_force_n[k]
        u = Instant(
            m.time_s[k],
            speed,
            m.angle_rad[k],
            m.position_m[k],
            force,
            m.angle_rad[k] * drive.sensor_to_rotor,
            m.motor_torque_nm[k],
        )
        motor, sensor = m.motor_torque_nm[k], m.torque_sensor_nm[k]
        if busy:
            motor = added.motor_nm(drive.effects, u, motor)
            sensor = added.sensor_nm(drive.effects, u, sensor)
        direction = speed if speed != 0.0 else m.travel_rad[k]
        if direction == 0.0:
            direction = z
        level = static_level_nm(direction, force, law)
        if busy:
            level = max(added.level_nm(drive.effects, u, level), SMALLEST_LEVEL_NM)
        at = 0 if direction >= 0.0 else 1
        for i in range(6):
            dlevel[i] = 0.0
        dlevel[at], dlevel[2 + at], dlevel[4 + at] = 1.0, abs(direction), abs(force)
        if speed == 0.0:
            dlevel[2 + at] = 0.0
        # the bristle's step, differentiated: z+ = z e^-d + travel (1 - e^-d)/d, d = slip s0/level
        travel, slip = m.travel_rad[k], m.slip_rad[k]
        d = slip * s0 / level
        kept = math.exp(-d)
        shape = (kept * (1.0 + d) - 1.0) / (d * d) if d > 1e-6 else -0.5 + d / 3.0
        by_decay = -z * kept + travel * shape
        z = bristle_step(z, travel, slip, level, s0)
        for i in range(6):
            dz[i] = kept * dz[i] - by_decay * d / level * dlevel[i]
        dz[6] = kept * dz[6] + by_decay * slip / level
        # T_f = s0 z + s1(w) (w - |w| s0 z / level)
        ratio = speed / law.sigma1_speed_rad_s
        fade = math.exp(-ratio * ratio) if ratio * ratio < 60.0 else 0.0
        s1 = law.sigma1_nm_s_per_rad * fade
        rate = speed - abs(speed) * s0 * z / level
        per_z = s0 - s1 * abs(speed) * s0 / level
        per_level = s1 * abs(speed) * s0 * z / (level * level)
        for i in range(6):
            out[1 + i, k] = -(per_z * dz[i] + per_level * dlevel[i])
        out[7, k] = -(per_z * dz[6] + z - s1 * abs(speed) * z / level)
        out[8, k] = -fade * rate
        out[9, k] = -s1 * rate * 2.0 * ratio * ratio / law.sigma1_speed_rad_s
        friction = friction_torque_nm(z, speed, level, law)
        if busy:
            friction += added.torque_nm(drive.effects, u, 0.0)
            added.advance(drive.effects, u, step)
        out[0, k] = motor + drive.sensor_to_rotor * sensor - force / drive.ratio - friction
