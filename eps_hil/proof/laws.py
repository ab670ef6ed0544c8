"""The physics of the truth plant, one law a function: friction, drag, motor, joints.

Equation numbers are the seed paper's; hidden terms are those of CONTRACT 8 and a few beyond it.
Torques and angles are at the rotor.
"""

import math

from eps_hil.compiled import njit
from eps_hil.proof.truth import Chain, Drive, Floats, Hidden, Slip

_LEAST_LEVEL_NM = 1.0e-3


@njit
def sliding_level(
    d: Drive, h: Hidden, side: float, speed: float, load: float, place: float, aged: float, t: float
) -> float:
    """T_fs (Nm) of eq. 3 for sliding towards ``side`` (±1), with all that is hidden in it.

    Here and below, what is not hidden is not computed: most of a run's time would go into
    exponentials and sines that are then multiplied by zero.
    """
    w, f = abs(speed), abs(load)
    if side > 0:
        level = d.k0_pos * h.coulomb_scale + d.kw_pos * w + d.kr_pos * f
    else:
        level = d.k0_neg * h.coulomb_scale + d.kw_neg * w + d.kr_neg * f
    level += side * h.half_difference_nm + h.load_gain * f
    if h.stribeck_nm != 0.0:
        level += h.stribeck_nm * math.exp(-((w / h.stribeck_speed) ** 2))
    if h.place_nm != 0.0:
        level += h.place_nm * math.exp(-(((place - h.place_centre_m) / h.place_width_m) ** 2))
    level += h.dwell_nm * aged
    if h.warmup != 0.0:
        level *= 1.0 + h.warmup * math.exp(-t / h.warmup_time_s)
    return max(level, _LEAST_LEVEL_NM)


@njit
def slip_friction(
    d: Drive, s: Slip, state: Floats, speed: float, forth: float, back: float, dt: float
) -> float:
    """One step of the Maxwell-slip elements; ``state`` (m,) holds their torques, returns T_f.

    An element is a spring that slips at its share of ``forth`` (Nm) in positive and of ``back``
    in negative direction; those that stick carry the damping σ1.
    """
    torque, sticking = 0.0, 0.0
    for i in range(len(state)):
        trial = state[i] + s.stiffness[i] * d.sigma0 * speed * dt
        top, bottom = s.level_share[i] * forth, -s.level_share[i] * back
        if trial > top:
            trial = top
        elif trial < bottom:
            trial = bottom
        else:
            sticking += s.stiffness[i]
        state[i] = trial
        torque += trial
    if sticking == 0.0:
        return torque
    return torque + _damping(d, speed) * speed * sticking


@njit
def bristle_friction(d: Drive, state: Floats, speed: float, level: float, dt: float) -> float:
    """One step of a LuGre bristle (eq. 2); ``state[0]`` is z in rad, returns T_f."""
    stretch = abs(speed) * d.sigma0 / level
    state[0] = (state[0] + speed * dt) / (1.0 + stretch * dt)
    return d.sigma0 * state[0] + _damping(d, speed) * (speed - stretch * state[0])


@njit
def _damping(d: Drive, speed: float) -> float:
    return d.sigma1 * math.exp(-((speed / d.sigma1_speed) ** 2))


@njit
def beside_friction(
    d: Drive, h: Hidden, speed: float, angle: float, place: float, load: float
) -> float:
    """Torque that opposes the drive and is neither load nor dry friction."""
    torque = h.viscous * speed + h.quadratic * speed * abs(speed) + h.spring * angle
    if h.screw_nm != 0.0:
        torque += h.screw_nm * math.sin(h.screw_harmonic * angle / d.belt_ratio + h.screw_phase)
    if h.cogging_nm != 0.0:
        torque += h.cogging_nm * math.sin(h.cogging_order * angle + h.cogging_phase)
    if h.static_nm != 0.0:
        torque += h.static_nm * math.exp(-(((place - h.static_centre_m) / h.static_width_m) ** 2))
    if h.alien_eddy_nm != 0.0:
        relative = speed / h.alien_eddy_speed
        torque += h.alien_eddy_nm * 2.0 * relative / (1.0 + relative * relative)
    if h.alien_load_ripple != 0.0:
        torque += h.alien_load_ripple * load * math.sin(h.alien_load_ripple_order * angle)
    if place > 0.0:
        torque += h.alien_one_way_drag * min(place / 0.01, 1.0) * speed
    return torque


@njit
def on_the_shaft(d: Drive, h: Hidden, reported: float, angle: float, heat: float) -> float:
    """Shaft torque (Nm) from what the ECU reports; ``heat`` in Nm² is T² averaged over time."""
    torque = h.motor_gain * reported + h.motor_offset_nm
    torque /= 1.0 + h.saturation * torque * torque
    if h.ripple != 0.0:
        torque *= 1.0 + h.ripple * math.sin(6.0 * d.pole_pairs * angle + h.ripple_phase)
    return torque * (1.0 - h.alien_heat_loss * heat)


@njit
def delayed(past: Floats, tick: int, late: float) -> float:
    """What a ring buffer of past values held ``late`` (not whole) ticks ago."""
    late = min(late, len(past) - 2.0)
    whole = int(late)
    newer, older = past[(tick - whole) % len(past)], past[(tick - whole - 1) % len(past)]
    return newer + (late - whole) * (older - newer)


@njit
def joint(c: Chain, i: int, twist: float, rate: float) -> float:
    """Torque that joint ``i`` hands from mass i to mass i + 1."""
    if c.gap_rad > 0.0 and i == c.rack - 1:
        half = 0.5 * c.gap_rad
        if abs(twist) <= half:
            return 0.0
        pressed = twist - math.copysign(half, twist)
        torque = c.stiffness[i] * pressed + c.damping[i] * rate
        return torque if torque * pressed > 0.0 else 0.0
    return c.stiffness[i] * twist + c.damping[i] * rate
