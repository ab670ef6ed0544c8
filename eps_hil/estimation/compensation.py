"""Friction compensation: dead zone → friction model → limiter (PAPER fig. 8, eq. 2 to 4a)."""

import math

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.estimation.levels import adapted_level_nm, approach
from eps_hil.estimation.setup import (
    ACCELERATION,
    ANGLE,
    ANGLE_BEFORE,
    ANGLE_EARLIER,
    ANGLE_NOISE,
    BRISTLE,
    CLOCK,
    DRIVE,
    DRIVE_BEFORE,
    DRIVE_NOISE,
    FORCE,
    HELD,
    LOCAL,
    NOISE,
    OMEGA,
    PATH,
    PHI,
    SLOPE,
    SPEED,
    SPEED_BEFORE,
    STEP_S,
    Constants,
    Inputs,
    Physics,
)
from eps_hil.physics.effects import added
from eps_hil.physics.effects.effect import Instant
from eps_hil.physics.friction import (
    SMALLEST_LEVEL_NM,
    bristle_step,
    friction_torque_nm,
)

CREEP_SIGMA = 3.0
"""Half width of the gap in which a resting rotor's angle is taken as noise."""


@njit
def instant_of(c: Constants, x: Physics, s: npt.NDArray[np.float64], u: Inputs) -> Instant:
    """What the physics is told of this millisecond; T_fs and effects need the load.

    The load is the last estimate, led by its own lag (the loop of PAPER's second trap); the angle
    is the measured one, else the observer's integrated one.
    """
    angle = u.motor_angle_rad if c.angle_seen else s[PHI]
    load = s[FORCE] + s[SLOPE] * (c.observer_lag_s + STEP_S)
    if c.known_force:
        load = u.rack_force_n
    i = Instant(
        s[CLOCK],
        u.motor_speed_rad_s,
        angle,
        angle / c.ratio,
        load,
        angle * c.sensor_to_rotor,
        u.motor_torque_nm,
        u.torque_sensor_nm,
        c.ratio,
    )
    if not x.use.position:
        return i
    i = moved(i, i.speed_rad_s, added.position_m(x.effects, i, i.position_m), load)
    s[LOCAL] = 1.0 / added.load_nm(x.effects, i, 1.0)
    if c.known_force:
        return i
    return moved(i, i.speed_rad_s, i.position_m, s[LOCAL] * load)


@njit
def drive_torque_nm(c: Constants, x: Physics, i: Instant, u: Inputs) -> float:
    """T_1m of eq. 1a (Nm, at the rotor), with what is known to be wrong with its two sensors."""
    motor, sensor = u.motor_torque_nm, u.torque_sensor_nm
    if x.use.motor:
        motor = added.motor_nm(x.effects, i, motor)
    if x.use.sensor:
        sensor = added.sensor_nm(x.effects, i, sensor)
    return motor + c.sensor_to_rotor * sensor


@njit
def friction_step(
    c: Constants, x: Physics, s: npt.NDArray[np.float64], u: Inputs, i: Instant, torque: float
) -> float:
    """Dead zone → friction model → limiter (eq. 2, 3, 4a): T̂_f in Nm at the rotor.

    ``torque`` is T_1m of this instant.
    """
    resting = _is_resting(c, s, u.motor_speed_rad_s, torque)
    travel, slip = _path(c, s, u, resting)
    speed = u.motor_speed_rad_s
    moving = 0.0 if resting else speed
    s[ACCELERATION] += c.acceleration_low_pass * ((speed - s[SPEED]) / STEP_S - s[ACCELERATION])
    s[SPEED_BEFORE], s[SPEED] = s[SPEED], speed
    direction = moving if moving != 0.0 else travel
    if direction == 0.0:
        direction = s[BRISTLE]
    approach(c, s)
    level = adapted_level_nm(x, s, direction, i.rack_force_n)
    now = moved(i, moving, i.position_m, i.rack_force_n)
    if x.use.level:
        level = added.level_nm(x.effects, now, level)
    level = max(level, SMALLEST_LEVEL_NM)
    if x.use.memory:
        added.advance(x.effects, now, STEP_S)
    before = abs(s[BRISTLE])
    s[BRISTLE] = bristle_step(s[BRISTLE], travel, slip, level, x.law.sigma0_nm_per_rad)
    if resting:  # no further than it can bend; but a noisy level must not ratchet it back
        limit = max(level / x.law.sigma0_nm_per_rad, before)
        s[BRISTLE] = min(max(s[BRISTLE], -limit), limit)
    friction = friction_torque_nm(s[BRISTLE], moving, level, x.law)
    if c.limit and abs(speed) < c.limiter_speed and abs(s[ACCELERATION]) < c.limiter_acceleration:
        friction = math.copysign(min(abs(friction), abs(torque)), friction)
    return friction + added.torque_nm(x.effects, i, 0.0) if x.use.torque else friction


@njit
def moved(i: Instant, speed_rad_s: float, position_m: float, rack_force_n: float) -> Instant:
    """The same instant with another motion and load."""
    return Instant(
        i.time_s,
        speed_rad_s,
        i.angle_rad,
        position_m,
        rack_force_n,
        i.pinion_rad,
        i.motor_torque_nm,
        i.torque_sensor_nm,
        i.ratio_rad_per_m,
    )


@njit
def _is_resting(c: Constants, s: npt.NDArray[np.float64], speed: float, torque: float) -> bool:
    """Whether the observed speed is no more than the noise that is there would make it."""
    bend = speed - 2.0 * s[SPEED] + s[SPEED_BEFORE]  # six times the variance of white noise
    s[NOISE] += c.noise_memory * (bend * bend / 6.0 - s[NOISE])
    bend = torque - 2.0 * s[DRIVE] + s[DRIVE_BEFORE]
    s[DRIVE_BEFORE], s[DRIVE] = s[DRIVE], torque
    s[DRIVE_NOISE] += c.noise_memory * (bend * bend / 6.0 - s[DRIVE_NOISE])
    sigma = math.sqrt(c.speed_noise_gain * s[NOISE] + c.torque_noise_gain * s[DRIVE_NOISE])
    return c.use_dead_zone and abs(s[OMEGA]) < max(c.dead_zone, c.dead_zone_sigma * sigma)


@njit
def _creep(c: Constants, s: npt.NDArray[np.float64], angle: float) -> float:
    """How far a resting rotor crept in this step: the low-passed angle, followed past a gap.

    Inside the gap (``CREEP_SIGMA`` deviations of the noise that is there) nothing is path, so noise
    wears no bristle down; beyond it creep both bends and wears it, as in eq. 2a.
    """
    bend = angle - 2.0 * s[ANGLE_BEFORE] + s[ANGLE_EARLIER]
    s[ANGLE_EARLIER], s[ANGLE_BEFORE] = s[ANGLE_BEFORE], angle
    s[ANGLE_NOISE] += c.noise_memory * (bend * bend / 6.0 - s[ANGLE_NOISE])
    s[ANGLE] += c.angle_low_pass * (angle - s[ANGLE])
    left = c.angle_low_pass / (2.0 - c.angle_low_pass)  # variance that the low-pass leaves
    gap = CREEP_SIGMA * math.sqrt(left * s[ANGLE_NOISE])
    before = s[HELD]
    s[HELD] = min(max(s[HELD], s[ANGLE] - gap), s[ANGLE] + gap)
    return s[HELD] - before


@njit
def _path(
    c: Constants, s: npt.NDArray[np.float64], u: Inputs, resting: bool
) -> tuple[float, float]:
    """Displacement of the step that bends the bristle, and the path that wears it down (rad).

    Noise would wear a resting bristle down, and integrated noise would let it wander. A measured
    angle still shows how far the rotor creeps, with an error that does not grow; without one, the
    recent path is kept and counted once the rotor is seen to move.
    """
    travel = 0.5 * (u.motor_speed_rad_s + s[SPEED]) * STEP_S
    if not resting:
        kept = s[PATH]
        s[ANGLE] = s[HELD] = s[ANGLE_BEFORE] = s[ANGLE_EARLIER] = u.motor_angle_rad
        s[PATH] = 0.0
        return travel + kept, abs(travel) + abs(kept)
    if c.angle_seen:
        creep = _creep(c, s, u.motor_angle_rad)
        return creep, abs(creep)
    s[PATH] += travel - c.path_forgetting * s[PATH]
    return 0.0, 0.0
