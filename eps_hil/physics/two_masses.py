"""Rotor and rack as two masses with a joint that gives or has play between them.

    J₁ dω₁/dt = T_em − T_f − τ
    J₂ dω₂/dt = τ + (i_pi/i_APA) T_sen − F_r/i_APA,      J₁ + J₂ = J_1m
    τ = stiffness · dz(φ₁ − φ₂) + damping · (ω₁ − ω₂),   dz: dead zone of the gap

With a stiff joint and no gap this is eq. 1 again. Friction and every other effect act on the
rotor as in ``simulate.py``; torques are at the rotor. The rotor's friction is solved implicitly,
the joint by semi-implicit Euler, which keeps an undamped joint's energy.
"""

import math

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.physics.effects import added
from eps_hil.physics.effects.effect import Joint
from eps_hil.physics.friction import bristle_step
from eps_hil.physics.simulate import (
    Drive,
    friction_nm,
    instant,
    level_nm,
    load_nm,
    motor_nm,
    sensor_nm,
)

STEP_S = 2e-5

Floats = npt.NDArray[np.float64]


@kernel
def joint_torque_nm(joint: Joint, twist_rad: float, rate_rad_s: float) -> float:
    """τ (Nm) that the rotor hands on; a gap passes nothing, and never pulls."""
    half = 0.5 * joint.gap_rad
    if half <= 0.0:
        return joint.stiffness_nm_per_rad * twist_rad + joint.damping_nm_s_per_rad * rate_rad_s
    if abs(twist_rad) <= half:
        return 0.0
    pressed = twist_rad - math.copysign(half, twist_rad)
    torque = joint.stiffness_nm_per_rad * pressed + joint.damping_nm_s_per_rad * rate_rad_s
    return torque if torque * pressed > 0.0 else 0.0


@kernel
def integrate(
    drive: Drive,
    joint: Joint,
    time_s: Floats,
    inputs: Floats,
    start: Floats,
    row: Floats,
    out: Floats,
) -> None:
    """Speed, angle, friction torque and rack angle at each instant into ``out`` (n, 4).

    ``row`` (3,) is for work.
    """
    speed, angle, bristle = start[0], start[1], start[2]
    first = drive.sensor_to_rotor * inputs[0, 1] - inputs[0, 2] / drive.ratio
    rack_speed, rack = speed, angle + rest_twist(joint, first)
    for k in range(len(time_s)):
        u = instant(drive, time_s[k], speed, angle, inputs[k])
        out[k, 0], out[k, 1], out[k, 3] = speed, angle, rack
        out[k, 2] = friction_nm(drive, u, level_nm(drive, u), bristle, bristle)
        if k + 1 == len(time_s):
            break
        speed, angle, bristle, rack_speed, rack = interval(
            drive,
            joint,
            time_s[k],
            time_s[k + 1] - time_s[k],
            speed,
            angle,
            bristle,
            rack_speed,
            rack,
            inputs[k],
            inputs[k + 1],
            row,
        )


@kernel
def interval(
    drive: Drive,
    joint: Joint,
    start_s: float,
    length_s: float,
    speed: float,
    angle: float,
    bristle: float,
    rack_speed: float,
    rack: float,
    before: Floats,
    after: Floats,
    row: Floats,
) -> tuple[float, float, float, float, float]:
    """The rotor's speed, angle and bristle, the rack's speed and angle after ``length_s``.

    Inputs run straight from ``before`` to ``after`` (3,); ``row`` (3,) is for work.
    """
    behind = joint.behind_share * drive.inertia
    rotor = drive.inertia - behind
    steps = max(1, int(np.ceil(length_s / STEP_S - 1e-6)))
    dt = length_s / steps
    for j in range(steps):
        part = (j + 0.5) / steps
        for i in range(3):
            row[i] = before[i] + part * (after[i] - before[i])
        t = start_s + part * length_s
        u = instant(drive, t, speed, angle, row)
        torque = joint_torque_nm(joint, angle - rack, speed - rack_speed)
        outer = drive.sensor_to_rotor * sensor_nm(drive, u) - load_nm(drive, u)
        rack_speed += dt / behind * (torque + outer)
        rack += dt * rack_speed
        middle, bristle = _middle(drive, rotor, t, speed, angle, bristle, row, dt, torque)
        if drive.use.memory:
            u = instant(drive, t, middle, angle + 0.5 * dt * middle, row)
            added.advance(drive.effects, u, dt)
        speed = 2.0 * middle - speed
        angle += dt * speed
    return speed, angle, bristle, rack_speed, rack


@kernel
def rest_twist(joint: Joint, outer_nm: float) -> float:
    """Rack angle less rotor angle at which the joint carries the first instant's load."""
    pressed = outer_nm / joint.stiffness_nm_per_rad
    return pressed + math.copysign(0.5 * joint.gap_rad, pressed) if pressed != 0.0 else 0.0


@kernel
def _middle(
    drive: Drive,
    inertia: float,
    t: float,
    speed: float,
    angle: float,
    bristle: float,
    row: Floats,
    dt: float,
    load_nm: float,
) -> tuple[float, float]:
    """The rotor's speed in the middle of a step against ``load_nm``, and the bristle after it."""
    law = drive.law
    middle, after = speed, bristle
    stiff = law.sigma1_nm_s_per_rad + 0.5 * dt * law.sigma0_nm_per_rad
    weight = inertia / (0.5 * dt)
    for _ in range(4):
        u = instant(drive, t, middle, angle + 0.5 * dt * middle, row)
        push = motor_nm(drive, u) - load_nm
        level = level_nm(drive, u)
        after = bristle_step(bristle, middle * dt, abs(middle) * dt, level, law.sigma0_nm_per_rad)
        friction = friction_nm(drive, u, level, bristle, after)
        middle = (weight * speed + push - friction + stiff * middle) / (weight + stiff)
    return middle, after
