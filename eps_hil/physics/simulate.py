"""Forward simulation of the 1-mass model (eq. 1c, 1d) under recorded torques and rack force.

Everything here is physical: instants, not stamps; sensor delays belong to who calls. Torques and
speeds are at the rotor, the rack force at the rack (signs: CONTRACT 1).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.physics.friction import (
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
    """The 1-mass model as compiled code takes it."""

    inertia: float
    ratio: float
    law: FrictionLaw


@dataclass(frozen=True, slots=True)
class Motion:
    """What the model does, at the instants of its inputs; all shape (n,)."""

    speed_rad_s: Floats
    angle_rad: Floats
    friction_torque_nm: Floats


def simulate(
    model: Model,
    time_s: Floats,
    drive_torque_nm: Floats,
    rack_force_n: Floats,
    *,
    speed_rad_s: float = 0.0,
    angle_rad: float = 0.0,
    bristle_rad: float = 0.0,
) -> Motion:
    """Run the model from the given state through inputs sampled at ``time_s``, all shape (n,).

    ``drive_torque_nm`` is T_1m of eq. 1a (motor plus torsion bar over the ratio), at the rotor.
    Inputs are straight lines between samples; each interval is cut into steps of 50 µs or less.
    """
    drive = Drive(
        model.inertia_kg_m2, model.rack_to_rotor_ratio_rad_per_m, friction_law(model.friction)
    )
    out = np.empty((len(time_s), 3))
    start = np.array([speed_rad_s, angle_rad, bristle_rad])
    _integrate(drive, time_s, drive_torque_nm, rack_force_n, start, out)
    return Motion(out[:, 0], out[:, 1], out[:, 2])


@njit
def _integrate(
    drive: Drive, time_s: Floats, torque: Floats, force: Floats, start: Floats, out: Floats
) -> None:
    speed, angle, bristle = start[0], start[1], start[2]
    for k in range(len(time_s)):
        level = static_level_nm(speed, force[k], drive.law)
        out[k, 0], out[k, 1] = speed, angle
        out[k, 2] = friction_torque_nm(bristle, speed, level, drive.law)
        if k + 1 == len(time_s):
            break
        interval = time_s[k + 1] - time_s[k]
        steps = max(1, int(np.ceil(interval / LONGEST_STEP_S - 1e-6)))
        dt = interval / steps
        for j in range(steps):
            part = (j + 0.5) / steps
            torque_now = torque[k] + part * (torque[k + 1] - torque[k])
            force_now = force[k] + part * (force[k + 1] - force[k])
            middle, bristle = _middle(drive, speed, bristle, torque_now, force_now, dt)
            angle += dt * middle
            speed = 2.0 * middle - speed


@njit
def _middle(
    drive: Drive, speed: float, bristle: float, torque: float, force: float, dt: float
) -> tuple[float, float]:
    """Speed in the middle of a step (implicit midpoint rule) and the bristle at its end."""
    law = drive.law
    middle, after = speed, bristle
    push = torque - force / drive.ratio
    for _ in range(4):
        level = static_level_nm(middle, force, law)
        after = bristle_step(bristle, middle * dt, abs(middle) * dt, level, law.sigma0_nm_per_rad)
        friction = friction_torque_nm(0.5 * (bristle + after), middle, level, law)
        # The friction's stiffness over the step makes the iteration contract at any speed.
        stiff = law.sigma1_nm_s_per_rad + 0.5 * dt * law.sigma0_nm_per_rad
        weight = drive.inertia / (0.5 * dt)
        middle = (weight * speed + push - friction + stiff * middle) / (weight + stiff)
    return middle, after
