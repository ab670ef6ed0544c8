"""The second estimator: an extended Kalman filter with the bristle inside, and a fixed lag.

One compiled step; live, replay and batch call the same machine code. Where the paper's estimator
hands a friction torque to a linear observer, this filter estimates [φ, ω, z, F_r, Ḟ_r] together:
the motion that follows tells how far the bristle was bent, so a reversal or a break-away is
evidence instead of an error (docs/theory-second-estimator.md). The published force is that of
``lag`` steps ago given all measurements since. No I/O, no clock.
"""

import math
from typing import NamedTuple, cast

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.estimation import acting
from eps_hil.estimation.bristle_model import Step, transition
from eps_hil.estimation.bristle_setup import (
    BRISTLE,
    FORCE,
    OMEGA,
    PHI,
    RATE,
    SIZE,
    Belief,
    FilterConstants,
    filter_constants,
    new_belief,
)
from eps_hil.estimation.compensation import drive_torque_nm, instant_of, moved
from eps_hil.estimation.gap import another_time, bridge, creep_unseen, rests, still_unknown
from eps_hil.estimation.levels import approach, tell
from eps_hil.estimation.memory import LONG_S, end_hold, hold_memory
from eps_hil.estimation.rack_force import publish, verdict
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Constants, Inputs, Physics
from eps_hil.estimation.state import (
    HELD,
    RUNS,
    Carried,
    Moment,
    Rig,
    begin_after_nonsense,
    begin_anew,
)
from eps_hil.estimation.validity import Reason
from eps_hil.physics.effects.added import Added, InUse
from eps_hil.physics.effects.effect import Instant
from eps_hil.physics.friction import (
    SMALLEST_LEVEL_NM,
    FrictionLaw,
    friction_torque_nm,
    static_level_nm,
)
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

_SETTLING = int(Reason.SETTLING)
_DIVERGED = int(Reason.DIVERGED)
_OUT_OF_RANGE = int(Reason.OUT_OF_RANGE)
_IMPOSSIBLE_N = 1e6
_RELAXED = 0.33
"""Standard deviation of an unknown bristle, in parts of the deflection at which it gives way."""
_KEPT = 0.5
"""Unknown friction, in parts of T_fs, up to which a deflection is taken over a gap."""
_SLIDING = 0.1
"""The same where the rotor is seen to move."""


class PhysicsInside(NamedTuple):
    """The physics that the filter's step is given: the model's, its constants and its memory."""

    law: FrictionLaw
    effects: Added
    use: InUse
    filter: FilterConstants
    belief: Belief


def physics_inside(
    model: Model, settings: EstimatorSettings, physics: Physics, angle_seen: bool
) -> Physics:
    """A model's physics with the filter's constants and a memory of its own.

    It is used wherever :class:`Physics` is; compiled code tells by the type which step is meant.
    """
    constants = filter_constants(model, settings, settings.step_s, angle_seen)
    return cast(
        Physics, PhysicsInside(physics.law, physics.effects, physics.use, constants, new_belief())
    )


@kernel
def filter_step(c: Constants, x: PhysicsInside, e: Carried, u: Inputs, reason: int) -> int:
    """One millisecond: updates belief and what is carried; returns the reason bits.

    The records are those of the paper's estimator; what outputs and added effects read of them
    is kept up. ``reason`` other than 0 holds the last estimate.
    """
    s, r = e.moment[0], e.rig[0]
    if reason != 0:
        hold_memory(Physics(x.law, x.effects, x.use), s, c.step_s)
        r.clock_s += c.step_s if r.clock_s > 0.0 else 0.0
        s.running = min(s.running, HELD)
        s.held_steps += 1
        return reason
    f, b = x.filter, x.belief
    approach(c, r)
    i = instant_of(c, Physics(x.law, x.effects, x.use), s, r, u)
    b.extra[2] = s.local
    law = _law_in_use(x.law, r)
    if x.use.position or x.use.load:
        law = in_mid_travel(law, s.local)
    known = Physics(law, x.effects, x.use)
    b.extra[1] = acting.torque_nm(x.effects, i, 0.0) if x.use.torque else 0.0
    torque = drive_torque_nm(c, known, i, u) - b.extra[1]
    if s.running != RUNS:
        anew = another_time(c, s, u, torque)
        end_hold(c, known, s, r, LONG_S if anew else s.held_steps * c.step_s)
        if anew:
            begin_anew(e)
        _start(c, f, known, b, s, u, i, torque)
    else:
        b.extra[0] = _extra_level_nm(known, i, b.mean)
        _predict(f, law, b, s, 0.5 * (torque + s.torque))
    if x.use.level or x.use.memory:
        tell(s, r, i)
    if x.use.memory:
        acting.advance(x.effects, i, c.step_s)
    s.torque = torque
    r.clock_s += c.step_s
    _open(f, b)
    _correct(f, b, 0, OMEGA, u.motor_speed_rad_s, f.speed_variance)
    if f.angle:
        _correct(f, b, 1, PHI, u.motor_angle_rad, f.angle_variance)
    b.place[0] += 1
    if not _possible(b):
        begin_after_nonsense(e, x.effects)
        return _DIVERGED
    s.phi, s.omega, s.bristle = b.mean[PHI], b.mean[OMEGA], b.mean[BRISTLE]
    s.bristle_rms = math.sqrt(b.cov[BRISTLE, BRISTLE])
    s.force, s.slope = b.mean[FORCE], 0.0
    _follow_unknown(c, f, law, b, s, u)
    s.drive = torque
    size = f.lag + 1
    s.filtered = b.ring[b.place[0] % size] if b.place[0] >= size else b.ring[0]
    s.unlimited = friction_nm(law, b.extra, b.mean)
    publish(c, s, s.unlimited)
    beyond = _OUT_OF_RANGE if x.use.ranged and acting.out_of_range(x.effects, i) else 0
    return verdict(c, s, r) | beyond


@kernel
def _follow_unknown(
    c: Constants, f: FilterConstants, law: FrictionLaw, b: Belief, s: Moment, u: Inputs
) -> None:
    """The unknown part of the friction: what sliding, or what was learned, left of it; and what
    creep may have made of it that no angle shows."""
    sigma0 = law.sigma0_nm_per_rad
    speed = b.mean[OMEGA]
    level = static_level_nm(speed if speed != 0.0 else b.mean[BRISTLE], b.mean[FORCE], law)
    level = max(level + b.extra[0], SMALLEST_LEVEL_NM)
    slides = abs(speed) > _slip_from(f, b)
    slip = abs(speed) * f.drive.step_s if slides else 0.0
    learned = unknown_torque_nm(law, b.cov[BRISTLE, BRISTLE])
    s.unknown_nm = min(still_unknown(s.unknown_nm, slip, level, sigma0), learned)
    s.unseen_nm = still_unknown(s.unseen_nm, slip, level, sigma0)
    if not slides and not f.angle:
        noise = u.speed_noise if u.speed_noise >= 0.0 else f.speed_variance
        other = static_level_nm(-b.mean[BRISTLE], b.mean[FORCE], law) + b.extra[0]
        s.unseen_nm = creep_unseen(c, s, noise, max(level, other), sigma0)
    s.unseen_nm = min(s.unseen_nm, learned)
    s.unknown_n = (s.unknown_nm + s.unseen_nm) * f.drive.ratio * s.local
    s.speed, s.last_angle = u.motor_speed_rad_s, u.motor_angle_rad


@kernel
def unknown_torque_nm(law: FrictionLaw, variance: float) -> float:
    """By how much the friction (Nm) may be off where z has that ``variance`` (rad²)."""
    return law.sigma0_nm_per_rad / _RELAXED * math.sqrt(max(variance, 0.0))


@kernel
def take_bristle(
    c: Constants, law: FrictionLaw, s: Moment, u: Inputs, bristle: float, unknown_nm: float
) -> None:
    """A held state whose ``bristle`` is known otherwise, as of the step before ``u``."""
    s.bristle, s.unknown_nm = bristle, unknown_nm
    s.bristle_rms = max(s.bristle_rms, _RELAXED * unknown_nm / law.sigma0_nm_per_rad)
    s.speed, s.acceleration, s.held_steps = u.motor_speed_rad_s, 0.0, 1
    s.last_angle = u.motor_angle_rad - u.motor_speed_rad_s * c.step_s
    s.angle = s.held = s.last_angle


@kernel
def _slip_from(f: FilterConstants, b: Belief) -> float:
    """Speed (rad/s) from which the rotor is taken to slide."""
    return max(f.slip_least_rad_s, f.slip_sigma * math.sqrt(b.cov[OMEGA, OMEGA]))


@kernel
def friction_nm(law: FrictionLaw, extra: Floats, mean: Floats) -> float:
    """T_f of eq. 2d and added torques (Nm) for a state; ``extra`` as in :class:`Belief`.

    The direction of a resting rotor is the bristle's.
    """
    direction = mean[OMEGA] if mean[OMEGA] * mean[BRISTLE] > 0.0 else mean[BRISTLE]
    level = max(static_level_nm(direction, mean[FORCE], law) + extra[0], SMALLEST_LEVEL_NM)
    return extra[1] + friction_torque_nm(mean[BRISTLE], mean[OMEGA], level, law)


@kernel
def in_mid_travel(law: FrictionLaw, local: float) -> FrictionLaw:
    """The law for a force as it would be in mid travel, where dφ/dx is ``local`` of that there."""
    return FrictionLaw(
        law.offset_pos_nm,
        law.offset_neg_nm,
        law.viscous_pos_nm_s_per_rad,
        law.viscous_neg_nm_s_per_rad,
        local * law.load_pos_nm_per_n,
        local * law.load_neg_nm_per_n,
        law.sigma0_nm_per_rad,
        law.sigma1_nm_s_per_rad,
        law.sigma1_speed_rad_s,
    )


@kernel
def _law_in_use(law: FrictionLaw, r: Rig) -> FrictionLaw:
    """The friction law with what adaptation has added to k0± so far."""
    return FrictionLaw(
        max(law.offset_pos_nm + r.added_pos, 0.0),
        max(law.offset_neg_nm + r.added_neg, 0.0),
        law.viscous_pos_nm_s_per_rad,
        law.viscous_neg_nm_s_per_rad,
        law.load_pos_nm_per_n,
        law.load_neg_nm_per_n,
        law.sigma0_nm_per_rad,
        law.sigma1_nm_s_per_rad,
        law.sigma1_speed_rad_s,
    )


@kernel
def _extra_level_nm(x: Physics, i: Instant, mean: Floats) -> float:
    """What added effects make of T_fs (Nm) at this state, beyond eq. 3, the way the bristle is."""
    if not x.use.level:
        return 0.0
    speed = math.copysign(mean[OMEGA], mean[BRISTLE])
    level = static_level_nm(speed, mean[FORCE], x.law)
    now = moved(i, mean[OMEGA], i.position_m, i.rack_force_n)
    return acting.level_nm(x.effects, now, level) - level


@kernel
def _start(
    c: Constants,
    f: FilterConstants,
    x: Physics,
    b: Belief,
    s: Moment,
    u: Inputs,
    i: Instant,
    torque: float,
) -> None:
    """Begin, or begin again: torque balance, with the bristle's ignorance shared by the force."""
    ratio, stiffness = f.drive.ratio, x.law.sigma0_nm_per_rad
    mean, cov = b.mean, b.cov
    speed = u.motor_speed_rad_s
    way = speed if speed != 0.0 else -1.0
    pos = static_level_nm(1.0, ratio * torque, x.law)
    neg = static_level_nm(-1.0, ratio * torque, x.law)
    most, extra = 0.0, pos if way >= 0.0 else neg
    if x.use.level:
        now = moved(i, 0.0, i.position_m, ratio * torque)  # it may have rested meanwhile
        most = max(acting.level_nm(x.effects, now, pos), acting.level_nm(x.effects, now, neg))
        if not rests(c, s, speed):
            now = moved(i, speed, i.position_m, ratio * torque)
        pos = max(acting.level_nm(x.effects, now, pos), SMALLEST_LEVEL_NM)
        neg = max(acting.level_nm(x.effects, now, neg), SMALLEST_LEVEL_NM)
    level, most = pos if way >= 0.0 else neg, max(pos, neg, most)
    extra = level - extra
    unsure = _RELAXED * level / stiffness
    if s.running == HELD:
        unsure = min(unsure, s.bristle_rms)
    bridge(c, s, u, torque, pos, neg, most, way, stiffness)
    bend = s.bristle
    if s.unknown_nm > _KEPT * level:
        bend, unsure = 0.0, _RELAXED * level / stiffness
    if abs(speed) > c.limiter_speed:
        bend, unsure = math.copysign(level / stiffness, speed), _SLIDING * level / stiffness
    mean[PHI], mean[OMEGA], mean[BRISTLE] = u.motor_angle_rad, speed, bend
    mean[FORCE], mean[RATE] = ratio * (torque - stiffness * bend), 0.0
    cov[:, :] = 0.0
    cov[PHI, PHI] = f.angle_variance if f.angle else 0.0
    cov[OMEGA, OMEGA] = f.speed_variance
    cov[BRISTLE, BRISTLE] = unsure * unsure
    cov[BRISTLE, FORCE] = cov[FORCE, BRISTLE] = -ratio * stiffness * unsure * unsure
    cov[FORCE, FORCE] = (ratio * stiffness * unsure) ** 2 + f.force_variance
    cov[RATE, RATE] = f.rate_start
    b.place[0], b.place[1] = 0, 1
    b.extra[0] = extra
    s.held = u.motor_angle_rad
    s.running, s.settle_steps, s.held_steps = RUNS, max(c.settle_steps, f.lag), 0


@kernel
def _predict(f: FilterConstants, law: FrictionLaw, b: Belief, s: Moment, torque: float) -> None:
    cov, a, t = b.cov, b.jacobian, b.scratch
    step = Step(torque, b.extra[0], _slip_from(f, b), s.held, f.gap_rad)
    _, s.held = transition(f.drive, law, step, b.mean, a)
    for i in range(SIZE):
        for j in range(SIZE):
            t[i, j] = 0.0
            for m in range(SIZE):
                t[i, j] += a[i, m] * cov[m, j]
    for i in range(SIZE):
        for j in range(i, SIZE):
            total = 0.0
            for m in range(SIZE):
                total += t[i, m] * a[j, m]
            cov[i, j] = cov[j, i] = total
    if not f.angle:  # φ is integrated only and tells nothing: keep it out
        cov[PHI, :] = 0.0
        cov[:, PHI] = 0.0
    kick, half = f.torque_speed, 0.5 * f.drive.step_s
    cov[OMEGA, OMEGA] += kick * kick
    if f.angle:
        cov[PHI, PHI] += half * half * kick * kick
        cov[PHI, OMEGA] += half * kick * kick
        cov[OMEGA, PHI] += half * kick * kick
    cov[FORCE, FORCE] += f.force_variance
    cov[RATE, RATE] += f.rate_variance
    for k in range(min(b.place[0], f.lag + 1)):
        for i in range(SIZE):
            total = 0.0
            for m in range(SIZE):
                total += a[i, m] * b.ring_cov[k, m]
            t[0, i] = total
        for i in range(SIZE):
            b.ring_cov[k, i] = t[0, i]
    b.place[1] = 0


@kernel
def _open(f: FilterConstants, b: Belief) -> None:
    """The present rack force enters the ring, in the place of the oldest."""
    at = b.place[0] % (f.lag + 1)
    b.ring[at] = b.mean[FORCE]
    for i in range(SIZE):
        b.ring_cov[at, i] = b.cov[FORCE, i]


@kernel
def _correct(
    f: FilterConstants, b: Belief, which: int, i: int, measured: float, variance: float
) -> None:
    """One scalar measurement of state ``i``: state, covariance, and the lagged forces."""
    cov, gain = b.cov, b.gain[which]
    spread = cov[i, i] + variance
    innovation = measured - b.mean[i]
    b.innovation[which], b.spread[which] = innovation, spread
    for k in range(min(b.place[0] + 1, f.lag + 1)):
        share = b.ring_cov[k, i] / spread
        b.ring[k] += share * innovation
        for j in range(SIZE):
            b.ring_cov[k, j] -= share * cov[i, j]
    for j in range(SIZE):
        gain[j] = cov[j, i] / spread
        b.mean[j] += gain[j] * innovation
    for j in range(SIZE):
        for m in range(j, SIZE):
            cov[j, m] -= gain[j] * spread * gain[m]
            cov[m, j] = cov[j, m]


@kernel
def _possible(b: Belief) -> bool:
    for i in range(SIZE):
        if not b.cov[i, i] >= 0.0:
            return False
    return abs(b.mean[FORCE]) < _IMPOSSIBLE_N and abs(b.mean[BRISTLE]) < _IMPOSSIBLE_N
