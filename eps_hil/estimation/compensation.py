"""Friction compensation: dead zone → friction model → limiter (PAPER fig. 8, eq. 2 to 4a)."""

import math

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.estimation.setup import (
    ACCELERATION,
    ANGLE,
    BRISTLE,
    DRIVE,
    DRIVE_BEFORE,
    DRIVE_NOISE,
    FORCE,
    NOISE,
    OMEGA,
    PATH,
    SLOPE,
    SPEED,
    SPEED_BEFORE,
    STEP_S,
    Constants,
    Inputs,
)
from eps_hil.physics.friction import (
    FrictionLaw,
    bristle_step,
    friction_torque_nm,
    static_level_nm,
)


@njit
def friction_step(c: Constants, law: FrictionLaw, s: npt.NDArray[np.float64], u: Inputs) -> float:
    """Dead zone → friction model → limiter (eq. 2, 3, 4a): T̂_f in Nm at the rotor."""
    speed = u.motor_speed_rad_s
    bend = speed - 2.0 * s[SPEED] + s[SPEED_BEFORE]  # six times the variance of white noise
    s[NOISE] += c.noise_memory * (bend * bend / 6.0 - s[NOISE])
    torque = u.motor_torque_nm + c.sensor_to_rotor * u.torque_sensor_nm
    bend = torque - 2.0 * s[DRIVE] + s[DRIVE_BEFORE]
    s[DRIVE_BEFORE], s[DRIVE] = s[DRIVE], torque
    s[DRIVE_NOISE] += c.noise_memory * (bend * bend / 6.0 - s[DRIVE_NOISE])
    sigma = math.sqrt(c.speed_noise_gain * s[NOISE] + c.torque_noise_gain * s[DRIVE_NOISE])
    threshold = max(c.dead_zone, c.dead_zone_sigma * sigma)
    resting = c.use_dead_zone and abs(s[OMEGA]) < threshold
    travel = 0.5 * (speed + s[SPEED]) * STEP_S
    slip = abs(travel)
    if resting:
        # Noise would wear a resting bristle down, and integrated noise would let it wander. A
        # measured angle still shows how far the rotor creeps, with an error that does not grow;
        # without one, the recent path is kept and counted once the rotor is seen to move.
        slip = 0.0
        if c.angle_seen:
            creep = c.angle_low_pass * (u.motor_angle_rad - s[ANGLE])
            s[ANGLE] += creep
            travel = creep
        else:
            s[PATH] += travel - c.path_forgetting * s[PATH]
            travel = 0.0
    else:
        s[ANGLE] = u.motor_angle_rad
        travel += s[PATH]
        slip += abs(s[PATH])
        s[PATH] = 0.0
    moving = 0.0 if resting else speed
    s[ACCELERATION] += c.acceleration_low_pass * ((speed - s[SPEED]) / STEP_S - s[ACCELERATION])
    s[SPEED_BEFORE], s[SPEED] = s[SPEED], speed
    # T_fs needs the load: the last estimate, led by its own lag (the loop of PAPER's second trap).
    load = s[FORCE] + s[SLOPE] * (c.observer_lag_s + STEP_S)
    if c.known_force:
        load = u.rack_force_n
    level = static_level_nm(moving if moving != 0.0 else s[BRISTLE], load, law)
    before = abs(s[BRISTLE])
    s[BRISTLE] = bristle_step(s[BRISTLE], travel, slip, level, law.sigma0_nm_per_rad)
    if resting:  # no further than it can bend; but a noisy level must not ratchet it back
        limit = max(level / law.sigma0_nm_per_rad, before)
        s[BRISTLE] = min(max(s[BRISTLE], -limit), limit)
    friction = friction_torque_nm(s[BRISTLE], moving, level, law)
    if c.limit and abs(speed) < c.limiter_speed and abs(s[ACCELERATION]) < c.limiter_acceleration:
        friction = math.copysign(min(abs(friction), abs(torque)), friction)
    return friction
