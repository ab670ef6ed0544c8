"""Where a rotor went while its estimate is held: by its angle alone, without the angle's jumps.

The bristle remembers its path: out and back again leaves it bent, where the contact slid on the
way out. So what is held for a doubt of other signals, or of the angle's zero, is carried along the
way that the angle shows meanwhile. Noise is no way: the angle is smoothed, by no more than noise,
and followed at a distance that noise does not pass. A step that no noise explains, nor the speed,
is another zero, and a sample before it may be of that step: each is followed once the next is seen.
"""

import math

from eps_hil.compiled import kernel
from eps_hil.estimation.compensation import CREEP_SIGMA, instant_of, moved
from eps_hil.estimation.levels import adapted_level_nm, level_in_use_nm, told_last
from eps_hil.estimation.setup import Constants, Inputs, Physics
from eps_hil.estimation.state import HELD, Moment, Records, Rig
from eps_hil.estimation.torque_jumps import take_friction
from eps_hil.estimation.watch import CREPT_RING, Limits, Watch
from eps_hil.physics.friction import bristle_step

_WRAP = CREPT_RING - 1
_UNSEEN_STEPS = 5
"""Steps without an angle over which the way goes on: a rotor that turns round within the
acceleration that counts as rest (SP_B of eq. 4a) hides half a milliradian in them."""


@kernel
def _noise(p: Limits, u: Inputs) -> float:
    """How far (rad) two samples of the angle may be apart by noise."""
    return max(p.angle_tolerance, math.sqrt(p.jump * max(u.angle_noise, 0.0)))


@kernel
def follow_creep(w: Watch, p: Limits, u: Inputs) -> None:
    """Take the angle of a step; what is drawn between lost samples counts at the next sample."""
    w.pending_turn += u.motor_angle_rad - w.angle
    w.pending_way += u.motor_speed_rad_s * p.step_s
    w.unbroken += 1
    if u.angle_periods <= 1.0:
        if min(abs(w.pending_turn), abs(w.pending_turn - w.pending_way)) >= _noise(p, u):
            w.zeroed, w.next_ahead = 0, w.smooth  # the sample before may be the jump, half way
        w.pending_turn = w.pending_way = 0.0
        w.ahead = w.next_ahead
        if w.zeroed < p.zero_steps:  # stands still until its zero is no single sample's
            w.zeroed += 1
            w.zero += (u.motor_angle_rad - w.smooth - w.zero) / w.zeroed
            w.ahead = w.next_ahead = w.smooth
        else:
            w.next_ahead = u.motor_angle_rad - w.zero
    w.smooth += p.creep_share * (w.ahead - w.smooth)
    near = CREEP_SIGMA * math.sqrt(max(u.angle_noise, 0.0))  # out and back is no noise
    w.smooth = min(max(w.smooth, w.ahead - near), w.ahead + near)
    left = p.creep_share / (2.0 - p.creep_share)  # variance that the low-pass leaves
    gap = CREEP_SIGMA * math.sqrt(left * max(u.angle_noise, 0.0))
    w.followed = min(max(w.followed, w.smooth - gap), w.smooth + gap)
    w.crept[w.unbroken & _WRAP] = w.followed


@kernel
def _no_way(w: Watch) -> None:
    """From here on nobody knows how the rotor got where it is."""
    w.pending_turn, w.pending_way, w.unbroken = 0.0, 0.0, 0


@kernel
def lose_sight(w: Watch) -> None:
    """A step without speed or angle: over a few the way goes on, over more it is lost."""
    if w.unbroken > 0 and w.sightless < _UNSEEN_STEPS:
        w.sightless += 1
        w.unbroken += 1
        w.crept[w.unbroken & _WRAP] = w.followed
        return
    _no_way(w)
    w.sightless = 0


@kernel
def see_again(w: Watch, p: Limits, u: Inputs) -> None:
    """Speed and angle are there again: where the rotor went meanwhile is to be counted.

    An angle that went another way than the speed tells may have another zero, or not: so the way
    is lost.
    """
    step_rad = u.motor_speed_rad_s * p.step_s
    turn, way = u.motor_angle_rad - step_rad - w.angle, w.sightless * step_rad
    w.pending_turn += turn
    w.pending_way += way
    w.angle, w.sightless = u.motor_angle_rad - step_rad, 0
    if min(abs(turn), abs(turn - way)) >= _noise(p, u):
        _no_way(w)


@kernel
def carry(w: Watch, c: Constants, x: Physics, s: Moment, r: Rig, steps: int) -> None:
    """Bend the bristle of a held state along the way of the last ``steps`` steps."""
    if s.running != HELD or not s.carried:
        return
    if w.unbroken <= steps or steps >= CREPT_RING:
        s.carried = 0
        return
    load = s.local * s.force
    for j in range(steps, 0, -1):
        last = w.crept[(w.unbroken - j) & _WRAP]
        went = w.crept[(w.unbroken - j + 1) & _WRAP] - last
        if went == 0.0:
            continue
        level = level_in_use_nm(x, r, went, told_last(s, went / c.step_s, load))
        sigma0 = x.law.sigma0_nm_per_rad
        limit = max(level / sigma0, abs(s.bent))
        s.bent = bristle_step(s.bent, went, abs(went), level, sigma0)
        s.bent = min(max(s.bent, -limit), limit)
    s.other_zero = w.zero - s.zero
    s.smoothed, s.followed = w.zero + w.smooth, w.zero + w.followed


@kernel
def slide_on(watch: Records, c: Constants, x: Physics, s: Moment, r: Rig, u: Inputs) -> None:
    """The friction of a step without an estimate, as the rotor went by its speed.

    It turns over where the rotor does, which is not to be taken for what a torque does
    (``torque_jumps.add_pace``).
    """
    w = watch[0]
    sigma0, went = x.law.sigma0_nm_per_rad, u.motor_speed_rad_s * c.step_s
    level = adapted_level_nm(x, r, went, s.local * s.force)
    if x.use.level:
        i = instant_of(c, x, s, r, u)
        i = moved(i, i.speed_rad_s, i.position_m, s.local * s.force)
        level = level_in_use_nm(x, r, went, i)
    bristle = bristle_step(w.bristle, went, abs(went), level, sigma0)
    friction_nm = w.friction_nm + sigma0 * (bristle - w.bristle)
    take_friction(watch, friction_nm, w.friction_known != 0, bristle)
