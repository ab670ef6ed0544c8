"""Friction compensation: dead zone → friction model → limiter (PAPER fig. 8, eq. 2 to 4a)."""

import math

from eps_hil.compiled import kernel
from eps_hil.estimation import acting
from eps_hil.estimation.gap import NOISE_SIGMA, creep_unseen, still_unknown
from eps_hil.estimation.levels import approach, level_in_use_nm, tell
from eps_hil.estimation.setup import Constants, Inputs, Physics
from eps_hil.estimation.state import Moment, Rig
from eps_hil.physics.effects.effect import Instant
from eps_hil.physics.friction import bristle_step, friction_torque_nm

LEAST_OF_LOAD = 0.1
"""Share of the rack force that arrives at the rotor, below which no law of it is believed."""
CREEP_SIGMA = 3.0
"""Half width of the gap in which a resting rotor's angle is taken as noise."""
_FORGOTTEN_PERIODS = 1.1
"""Of a hole in speed or angle, as the low-pass forgets it: what is drawn in it is no bias."""
_ASTRAY_N = 100.0
"""Rack force by which a biased angle may put the friction wrong, from which on it is unknown."""


@kernel
def instant_of(c: Constants, x: Physics, s: Moment, r: Rig, u: Inputs) -> Instant:
    """What the physics is told of this millisecond; T_fs and effects need the load.

    The load is the last estimate, led by its own lag (the loop of PAPER's second trap); the angle
    is the measured one, else the observer's integrated one.
    """
    angle = u.motor_angle_rad if c.angle_seen else s.phi
    load = s.force + s.slope * (c.observer_lag_s + c.step_s)
    if c.known_force:
        load = u.rack_force_n
    i = Instant(
        r.clock_s,
        u.motor_speed_rad_s,
        angle,
        angle / c.ratio,
        load,
        angle * c.sensor_to_rotor,
        u.motor_torque_nm,
        u.torque_sensor_nm,
        c.ratio,
    )
    if not x.use.position and not x.use.load:
        return i
    if x.use.position:
        i = moved(i, i.speed_rad_s, acting.position_m(x.effects, i, i.position_m), load)
    if x.use.load:
        here = i if c.known_force else moved(i, i.speed_rad_s, i.position_m, s.local * load)
        whole, more = acting.load_nm(x.effects, here, 1.0), acting.load_nm(x.effects, here, 0.0)
        s.local = 1.0 / max(whole - more, LEAST_OF_LOAD)
    if c.known_force:
        return i
    return moved(i, i.speed_rad_s, i.position_m, s.local * load)


@kernel
def drive_torque_nm(c: Constants, x: Physics, i: Instant, u: Inputs) -> float:
    """T_1m of eq. 1a (Nm, at the rotor), with what is known of its two sensors and the load."""
    motor, sensor = u.motor_torque_nm, u.torque_sensor_nm
    if x.use.motor:
        motor = acting.motor_nm(x.effects, i, motor)
    if x.use.sensor:
        sensor = acting.sensor_nm(x.effects, i, sensor)
    if x.use.load:  # what of the load does not grow with it
        motor -= acting.load_nm(x.effects, i, 0.0)
    return motor + c.sensor_to_rotor * sensor


@kernel
def friction_step(
    c: Constants, x: Physics, s: Moment, r: Rig, u: Inputs, i: Instant, torque: float
) -> float:
    """Dead zone → friction model → limiter (eq. 2, 3, 4a): T̂_f in Nm at the rotor.

    ``torque`` is T_1m of this instant.
    """
    resting = _is_resting(c, s, u, torque)
    travel, slip = _path(c, s, u, resting)
    if s.wary:
        s.wary_way += slip
    speed = u.motor_speed_rad_s
    moving = 0.0 if resting else speed
    s.acceleration += c.acceleration_low_pass * ((speed - s.speed) / c.step_s - s.acceleration)
    s.speed_before, s.speed = s.speed, speed
    direction = moving if moving != 0.0 else travel
    if direction == 0.0:
        direction = s.bristle
    approach(c, r)
    now = moved(i, moving, i.position_m, i.rack_force_n)
    level = level_in_use_nm(x, r, direction, now)
    if x.use.level or x.use.memory:
        tell(s, r, now)
    if x.use.memory:
        acting.advance(x.effects, now, c.step_s)
    s.unknown_nm = still_unknown(s.unknown_nm, slip, level, x.law.sigma0_nm_per_rad)
    s.unseen_nm = still_unknown(s.unseen_nm, slip, level, x.law.sigma0_nm_per_rad)
    if resting and not c.angle_seen:
        most = max(level, level_in_use_nm(x, r, -direction, now))
        s.unseen_nm = creep_unseen(c, s, s.speed_noise, most, x.law.sigma0_nm_per_rad)
    s.unknown_n = (s.unknown_nm + s.unseen_nm) * c.ratio * s.local
    if s.bias_slid != s.bias:
        _count_bias(c, s, slip, level, x.law.sigma0_nm_per_rad)
    before = abs(s.bristle)
    s.bristle = bristle_step(s.bristle, travel, slip, level, x.law.sigma0_nm_per_rad)
    if resting:  # no further than it can bend; but a noisy level must not ratchet it back
        limit = max(level / x.law.sigma0_nm_per_rad, before)
        s.bristle = min(max(s.bristle, -limit), limit)
    friction = s.unlimited = friction_torque_nm(s.bristle, moving, level, x.law)
    if c.limit and abs(speed) < c.limiter_speed and abs(s.acceleration) < c.limiter_acceleration:
        least = max(abs(torque), abs(friction) - s.unknown_nm)
        friction = math.copysign(min(abs(friction), least), friction)
    if not x.use.torque:
        return friction
    more = acting.torque_nm(x.effects, i, 0.0)
    s.unlimited += more
    return friction + more


@kernel
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


@kernel
def _noise(c: Constants, variance: float, bend: float, known: float) -> float:
    """Variance of an input's white noise: the known one, else followed by second differences."""
    if known >= 0.0:
        return known
    return variance + c.noise_memory * (bend * bend / 6.0 - variance)


@kernel
def _noise_gain(gain: float, periods: float) -> float:
    """What a low-pass leaves of the noise of what is read between samples so many periods apart.

    ``gain``: where none is missing. It is averaged over fewer of them where some are.
    """
    return min(gain * periods, max(gain, 1.0))


@kernel
def _periods_held(c: Constants, held: float, periods: float) -> float:
    """The most that samples were apart, wearing off as the angle's low-pass forgets."""
    return max(held - c.angle_low_pass * (held - 1.0), periods)


@kernel
def _is_resting(c: Constants, s: Moment, u: Inputs, torque: float) -> bool:
    """Whether the observed speed is no more than the noise that is there would make it.

    A torque that the rotor does not follow drives the observed speed off for a while. Where there
    is such a doubt the measured speed has to say that it moves, too.
    """
    speed = u.motor_speed_rad_s
    bend = speed - 2.0 * s.speed + s.speed_before
    s.speed_noise = _noise(c, s.speed_noise, bend, u.speed_noise)
    bend = torque - 2.0 * s.drive + s.drive_before
    s.drive_before, s.drive = s.drive, torque
    s.drive_noise = _noise(c, s.drive_noise, bend, u.drive_noise)
    s.speed_periods = _periods_held(c, s.speed_periods, u.speed_periods)
    gain = _noise_gain(c.speed_noise_gain, s.speed_periods)
    sigma = math.sqrt(gain * s.speed_noise + c.torque_noise_gain * s.drive_noise)
    zone = max(c.dead_zone, c.dead_zone_sigma * sigma)
    resting = abs(s.omega) < zone
    if not resting and s.wary:
        resting = speed * speed < zone * zone + CREEP_SIGMA * CREEP_SIGMA * s.speed_noise
    return c.use_dead_zone and resting


@kernel
def _follow(c: Constants, s: Moment, u: Inputs, travel: float, resting: bool) -> float:
    """How far the rotor went in this step, by speed and angle together.

    In motion a complementary filter: the speed gives the step, the angle keeps the sum from
    drifting. At rest the low-passed angle alone, and past a gap (``CREEP_SIGMA`` deviations of the
    noise that is there): inside it nothing is path, so noise wears no bristle down; beyond it creep
    both bends and wears it, as in eq. 2a. What filter and gap hold back is counted when the rotor
    leaves its rest.
    """
    angle = u.motor_angle_rad
    bend = angle - 2.0 * s.angle_before + s.angle_earlier
    s.angle_earlier, s.angle_before = s.angle_before, angle
    s.angle_noise = _noise(c, s.angle_noise, bend, u.angle_noise)
    s.angle_periods = _periods_held(c, s.angle_periods, u.angle_periods)
    before = s.held
    if not resting:
        s.angle += travel
    s.angle += c.angle_low_pass * (angle - s.angle)
    apart, noise = angle - s.angle, math.sqrt(s.angle_noise)
    if c.speed_seen and max(s.angle_periods, s.speed_periods) < _FORGOTTEN_PERIODS:
        s.bias = min(max(s.bias, apart - NOISE_SIGMA * noise), apart + NOISE_SIGMA * noise)
    if resting:
        left = c.angle_low_pass / (2.0 - c.angle_low_pass)  # variance that the low-pass leaves
        gap = CREEP_SIGMA * math.sqrt(_noise_gain(left, s.angle_periods)) * noise
        s.held = min(max(s.held, s.angle - gap), s.angle + gap)
        return s.held - before
    s.held = s.angle
    return s.held - before


@kernel
def _count_bias(c: Constants, s: Moment, slip: float, level: float, sigma0: float) -> None:
    """A speed that is off draws the filtered angle away; its way back bends the bristle.

    Sliding forgets the way out. So what counts is by how much the angle's bias has changed since;
    a bristle that is bent the other way follows by up to twice as much (eq. 2a).
    """
    off = s.bias_slid - s.bias
    left_nm = still_unknown(sigma0 * abs(off), slip, level, sigma0)
    s.bias_slid = s.bias + math.copysign(left_nm / sigma0, off)
    astray_n = 2.0 * left_nm * c.ratio * s.local
    if astray_n > _ASTRAY_N:
        s.unknown_n = max(s.unknown_n, astray_n)


@kernel
def _path(c: Constants, s: Moment, u: Inputs, resting: bool) -> tuple[float, float]:
    """Displacement of the step that bends the bristle, and the path that wears it down (rad).

    Noise would wear a resting bristle down, and integrated noise would let it wander. A measured
    angle still shows how far the rotor creeps, with an error that does not grow; without one, the
    recent path is kept and counted once the rotor is seen to move.
    """
    travel = 0.5 * (u.motor_speed_rad_s + s.speed) * c.step_s
    s.last_angle = u.motor_angle_rad
    if c.angle_seen:
        went = _follow(c, s, u, travel, resting)
        if not c.use_dead_zone:  # as published: the speed alone
            went = travel
        return went, abs(went)
    if not resting:
        kept = s.path
        s.path = 0.0
        return travel + kept, abs(travel) + abs(kept)
    s.path += travel - c.path_forgetting * s.path
    return 0.0, 0.0
