"""The bristle over a gap in the inputs, and how much of its deflection is unknown (eq. 2a).

Nobody measures the bristle. Where its history is not known its torque may be anything between
−T_fs and +T_fs, and the rack force is wrong by up to i_APA times that. What the friction may be
off by, u (Nm), dies out as eq. 2a forgets its start, u⁺ = u exp(−|ω| σ0 Δt / T_fs): some
hundredths of a radian of sliding are enough, and no time at rest is.
"""

import math

from eps_hil.compiled import kernel
from eps_hil.estimation.levels import level_in_use_nm, told_last
from eps_hil.estimation.setup import Constants, Inputs, Physics
from eps_hil.estimation.state import HELD, NEVER_RAN, NOBODY_KNOWS, Moment, Rig
from eps_hil.physics.friction import bristle_step

NOISE_SIGMA = 4.0
"""Deviations of a single angle within which a rotor did not creep."""
GAIN = 0.25
"""Share by which a way may differ from that of the speeds before and after it."""
KNOWN_NM = 1e-6
"""Less than this is nothing, and costs no exponential."""


@kernel(inline="always")
def still_unknown(unknown_nm: float, slip_rad: float, level_nm: float, sigma0: float) -> float:
    """What is unknown of the friction (Nm) after a path of ``slip_rad``."""
    if unknown_nm < KNOWN_NM or slip_rad == 0.0:
        return unknown_nm
    return unknown_nm * math.exp(-slip_rad * sigma0 / level_nm)


@kernel
def creep_unseen(c: Constants, s: Moment, noise: float, most_nm: float, sigma0: float) -> float:
    """By how much (Nm) the friction may be off since a rotor rests, after one more step of that,
    where no angle is measured.

    Creep is told from rest by the mean of the speeds alone, of which ``noise`` is the variance
    ((rad/s)²; a speed in steps seems to have none, so it is ``dead_zone_rad_s`` squared at least).
    What it makes of the way adds up as noise does, to no more than the bristle's bend and T_fs
    (``most_nm``, Nm).
    """
    more = sigma0 * sigma0 * max(noise, c.dead_zone * c.dead_zone) * c.way_per_noise
    anything, before = sigma0 * abs(s.bristle) + most_nm, s.unseen_nm
    return max(min(math.sqrt(before * before + more), anything), before)


@kernel
def lose_way(x: Physics, s: Moment, r: Rig, way_rad: float) -> None:
    """The rotor went ``way_rad`` out and back again, nobody knows how far each way."""
    sigma0, i = x.law.sigma0_nm_per_rad, told_last(s, 0.0, s.local * s.force)
    most = max(level_in_use_nm(x, r, 1.0, i), level_in_use_nm(x, r, -1.0, i))
    anything = sigma0 * abs(s.bristle) + most
    s.unknown_nm = min(s.unknown_nm + sigma0 * max(way_rad, 0.0), anything)


@kernel
def misled(x: Physics, s: Moment, r: Rig) -> None:
    """A torque that was doubted, and estimated on with, was wrong: what that made of the bristle.

    T_fs follows the load, and the load was taken from that torque: the way since then bent the
    bristle towards another end than its own.
    """
    lose_way(x, s, r, s.wary_way)
    s.wary_way = 0.0


@kernel
def _most_torque(c: Constants, s: Moment) -> float:
    """By how much T_1m (Nm) of two steps may differ that balance the same load."""
    return c.unknown_limit_n / c.ratio + NOISE_SIGMA * math.sqrt(2.0 * s.drive_noise)


@kernel
def another_time(c: Constants, s: Moment, u: Inputs, torque: float) -> bool:
    """Whether nobody knows how long inputs were missing, nor that nothing happened meanwhile.

    It did not where the clock was set and the rotor rests as it did, by angle and ``torque``
    (T_1m, Nm).
    """
    if s.held_steps < NOBODY_KNOWS:
        return False
    most_rad = NOISE_SIGMA * math.sqrt(2.0 * max(s.angle_noise, c.first_angle_noise))
    slow = abs(s.speed) < c.limiter_speed and abs(u.motor_speed_rad_s) < c.limiter_speed
    turned = abs(u.motor_angle_rad - s.last_angle)
    same = (
        slow and c.angle_seen and turned < most_rad and abs(torque - s.drive) < _most_torque(c, s)
    )
    return s.running != HELD or not same


@kernel
def rests(c: Constants, s: Moment, speed: float) -> bool:
    """Whether the rotor rests on both sides of a gap, after which its ``speed`` is that (rad/s).

    One that turns round does not, by eq. 4a.
    """
    turning = abs(s.acceleration) > c.limiter_acceleration
    return max(abs(s.speed), abs(speed)) < c.limiter_speed and not turning


@kernel
def _cannot_turn(c: Constants, turn_rad: float, time_s: float) -> bool:
    """Whether a rotor cannot turn so far from rest to rest, by half the time up and half down.

    A jump that a single sample may make is never taken for one: of that the step at the gap's end
    may be read half way.
    """
    furthest = 0.25 * c.largest_acceleration * time_s * time_s
    return abs(turn_rad) > max(furthest, c.largest_turn)


@kernel
def _steady(c: Constants, s: Moment, speed: float, gap_s: float, off: float, most: float) -> bool:
    """Whether a rotor slid on over a gap, and its angle tells it.

    ``off`` and ``most``: by how much (rad) the angle's way is not that of the speeds, and may be
    if these do not change.
    """
    slack = c.limiter_speed + c.limiter_acceleration * gap_s
    return abs(off) < most + slack * gap_s and abs(speed - s.speed) < slack


@kernel
def _angle_beyond(
    c: Constants, s: Moment, u: Inputs, before: float, went: float, hidden: float
) -> float:
    """Where a rotor that slid on was in the step before ``u`` (rad): by its speeds and its angle.

    ``before``: its filtered angle before the gap; ``went``: its way over the gap by the speeds,
    from which a rotor that bends its course departs by ``hidden`` (rad). Each counts as it is
    certain. The noise of a single angle would be taken for a way out, and its end for a way back.
    """
    told, gap_s = before + went, s.held_steps * c.step_s
    seen = u.motor_angle_rad - u.motor_speed_rad_s * c.step_s
    left = c.angle_low_pass / (2.0 - c.angle_low_pass)  # variance that the low-pass leaves
    unsure = left * s.angle_noise + 0.5 * gap_s * gap_s * s.speed_noise + hidden * hidden
    if s.angle_noise <= 0.0:
        return seen
    return told + unsure / (unsure + s.angle_noise) * (seen - told)


@kernel
def bridge(
    c: Constants,
    s: Moment,
    u: Inputs,
    torque: float,
    pos: float,
    neg: float,
    most: float,
    way: float,
    sigma0: float,
) -> None:
    """Bristle and what is unknown of it as estimating begins, or begins again after held steps.

    ``torque``: T_1m (Nm) now. ``pos``, ``neg``: T_fs (Nm) of either direction; that of ``way`` is
    the one that counts. ``most``: the largest that it may have been at rest or is now.

    A rotor at rest on both sides of a gap (one that turns round is not, by eq. 4a), its angle
    changed by less than the bristle can bend, has kept its bristle. Without an angle it may have
    moved and come back: no further than the acceleration that counts as rest (SP_B of eq. 4a) takes
    it, a path of SP_B T²/8. A rotor that slid on, its angle measured and its speed changed by no
    more than noise (SP_A) and SP_B T, has taken the bristle along by that angle, where such speeds
    go so far, and the same path is all that it may have hidden; it is placed by both, each as it is
    certain. An angle that jumped tells nothing
    of a rotor at rest on both sides: it is as if there were none, and has another zero since. So
    it is where speed and angle parted, and the angle shows in the end another way than the speed
    did, or than none: nobody knows which of them was wrong. And where its zero was seen to change,
    which may hide a way as large; and where its change is too small for the torque's: another load
    bends the bristle that holds a rotor, and an angle that begins again at zero where it was near
    zero says that nothing moved.

    Where inputs came all the while and the angle's zero is what it was, the bristle is where its
    way took it (creep.py), if that matters: out and back again may leave it bent.

    Creep that is no more than the angle's noise is followed from where it was, noise filtered.
    More of it bends the bristle at once: were the rotor then judged as moving, it would leave
    behind what the filter holds back. Where the gap is so long that twice the bend at break-away
    may have been gone in it, such a rotor may have gone on and come back: by its way as much is
    unknown.
    """
    level = pos if way >= 0.0 else neg
    end = level / sigma0
    speed = u.motor_speed_rad_s
    angle, held = s.angle, s.held
    s.angle = s.held = s.angle_before = s.angle_earlier = u.motor_angle_rad
    if s.running == NEVER_RAN:
        moving = abs(speed) > c.limiter_speed
        s.bristle = math.copysign(end, speed) if moving else 0.0
        s.unknown_nm = sigma0 * abs(s.bristle) + most
        return
    change = u.motor_angle_rad - s.last_angle if c.angle_seen else 0.0
    gap_s = s.held_steps * c.step_s
    hidden = furthest = 0.125 * c.limiter_acceleration * gap_s * gap_s
    rested = rests(c, s, speed)
    went = 0.5 * (s.speed + speed) * gap_s
    far = NOISE_SIGMA * math.sqrt(2.0 * max(s.angle_noise, c.first_angle_noise))
    steady = _steady(c, s, speed, gap_s, change - went, far + GAIN * abs(went))
    stood = abs(torque - s.drive) > _most_torque(c, s) + sigma0 * (abs(change) + far)
    disputed = s.parted != 0 and min(abs(change), abs(change - s.went)) > far
    other_zero = s.carried != 0 and abs(s.other_zero) > far
    jumped = disputed or stood or other_zero or _cannot_turn(c, change, gap_s + c.step_s)
    jumped = jumped and rested and c.angle_seen
    s.parted = 0
    change = 0.0 if jumped else change
    s.leapt += abs(change)
    if c.angle_seen and rested and not jumped:
        hidden = 0.0
    kept = abs(change) + hidden < end if rested else c.angle_seen and steady
    if kept and not rested:
        s.angle = _angle_beyond(c, s, u, angle, went, hidden)
        change, s.held = s.angle - held, s.angle
    if kept and jumped:
        s.unknown_nm = min(s.unknown_nm + sigma0 * hidden, sigma0 * abs(s.bristle) + most)
        return
    bent = sigma0 * abs(s.bent - s.bristle) > c.unknown_limit_n / c.ratio
    if kept and rested and bent and s.carried and not other_zero:
        s.bristle = s.bent
        s.angle, s.held = s.smoothed, s.followed
        return
    if kept and rested and c.angle_seen:
        crept = u.motor_angle_rad - held
        noise = NOISE_SIGMA * NOISE_SIGMA * 2.0 * s.angle_noise  # of both angles
        if crept * crept < noise or noise == 0.0:  # the bristle filter follows creep by itself
            s.angle, s.held = angle, held
            return
        change = crept if abs(crept) < end else change
        level, end = pos if change >= 0.0 else neg, most / sigma0
        if furthest > 2.0 * end and abs(change) > far:  # it moved: perhaps further, and back
            hidden = abs(change)
    end = max(end, abs(s.bristle))  # a level that is less now bends nothing back
    s.bristle = min(max(bristle_step(s.bristle, change, abs(change), level, sigma0), -end), end)
    anything = sigma0 * abs(s.bristle) + most
    s.unknown_nm = min(s.unknown_nm + (sigma0 * hidden if kept else anything), anything)
