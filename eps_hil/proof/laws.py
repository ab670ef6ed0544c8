"""The physics of the truth plant, one law a function: friction, drag, motor, joints.

Equation numbers are the seed paper's; hidden terms are those of CONTRACT 8 and a few beyond it.
Torques and angles are at the rotor.
"""

import math

from eps_hil.compiled import kernel
from eps_hil.proof.truth import Chain, Drive, Floats, Hidden, Slip

_LEAST_LEVEL_NM = 1.0e-3


@kernel
def sliding_level(
    d: Drive,
    h: Hidden,
    side: float,
    speed: float,
    load: float,
    place: float,
    aged: float,
    t: float,
    more: float = 0.0,
) -> float:
    """T_fs (Nm) of eq. 3 for sliding towards ``side`` (±1), with all that is hidden in it.

    ``more``: what the rest of the drive adds to it now (:func:`pressed`).

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
    level += h.dwell_nm * aged + more
    if h.warmup != 0.0:
        level *= 1.0 + h.warmup * math.exp(-t / h.warmup_time_s)
    return max(level, _LEAST_LEVEL_NM)


@kernel
def pressed(
    h: Hidden,
    speed: float,
    shaft: float,
    hand: float,
    load: float,
    recent: float,
    turned: float,
) -> float:
    """What flanks, guide, nut, bearing, seal and film add to T_fs (Nm).

    ``recent``: mean |ω| (rad/s); ``turned``: time since the rotor last turned round (s).
    """
    more = h.alien_guide * abs(hand) + h.alien_speed_memory * recent
    more += h.last_column_rub * hand * hand  # what the hand bends grows with what it presses
    if shaft * speed < 0.0:  # the load drives the motor: the other flanks rub
        more += h.alien_driven_loss * abs(shaft)
    if load > h.alien_thrust_from_n:
        more += h.alien_thrust * (load - h.alien_thrust_from_n)
    if load * speed < 0.0:  # the rack drives the screw
        more += h.late_nut_loss * abs(load)
    if h.late_seal_nm != 0.0:  # a lip that pressure lifts to its stop
        more += h.late_seal_nm * math.tanh(abs(load) / h.late_seal_n)
    if h.late_film != 0.0:  # a film that has yet to form
        more += h.late_film * math.exp(-turned / h.late_film_s)
    if h.late_film_peak_nm != 0.0:  # mixed lubrication at its worst
        off = (abs(speed) - h.late_film_peak_at) / h.late_film_peak_wide
        more += h.late_film_peak_nm * math.exp(-off * off)
    return more


@kernel
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


@kernel
def bristle_friction(d: Drive, state: Floats, speed: float, level: float, dt: float) -> float:
    """One step of a LuGre bristle (eq. 2); ``state[0]`` is z in rad, returns T_f."""
    stretch = abs(speed) * d.sigma0 / level
    state[0] = (state[0] + speed * dt) / (1.0 + stretch * dt)
    return d.sigma0 * state[0] + _damping(d, speed) * (speed - stretch * state[0])


@kernel
def _damping(d: Drive, speed: float) -> float:
    return d.sigma1 * math.exp(-((speed / d.sigma1_speed) ** 2))


@kernel
def beside_friction(
    d: Drive,
    h: Hidden,
    speed: float,
    angle: float,
    place: float,
    load: float,
    bush: float,
    wet: float,
) -> float:
    """Torque that opposes the drive and is neither load nor dry friction.

    ``bush``: -1 to 1; ``wet``: speed that a film follows late (rad/s).
    """
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
    if h.alien_unbalance != 0.0:
        torque += h.alien_unbalance * speed * speed * math.sin(angle + h.alien_unbalance_phase)
    torque += h.alien_bushing_nm * bush + h.alien_travel_drag * (place / 0.01) ** 2 * speed
    if place > 0.0:
        torque += h.alien_one_way_drag * min(place / 0.01, 1.0) * speed
    if h.late_worn_tooth_nm != 0.0:
        worn = math.exp(-((place / h.late_worn_tooth_wide_m) ** 2))
        torque += h.late_worn_tooth_nm * worn * math.sin(h.late_worn_tooth_order * angle)
    if h.last_screw_travel != 0.0:  # a screw that is worth less at one end
        torque += h.last_screw_travel * (place / 0.01) * load / d.rack_rad_per_m
    if h.last_fading_cogging_nm != 0.0:  # a cogging that the inverter compensates at speed
        left = math.exp(-abs(speed) / h.last_fading_cogging_speed)
        torque += h.last_fading_cogging_nm * left * math.sin(h.last_fading_cogging_order * angle)
    return torque + h.late_wet_drag * wet


@kernel
def on_the_shaft(
    d: Drive, h: Hidden, reported: float, angle: float, speed: float, heat: float, t: float
) -> float:
    """Shaft torque (Nm) from what the ECU reports; ``heat`` in Nm² is T² averaged over time."""
    torque = h.motor_gain * reported + h.motor_offset_nm
    torque /= 1.0 + h.saturation * torque * torque
    if h.ripple != 0.0:
        torque *= 1.0 + h.ripple * math.sin(6.0 * d.pole_pairs * angle + h.ripple_phase)
    if h.alien_ripple != 0.0:
        wave = math.sin(h.alien_ripple_order * angle + h.alien_ripple_phase)
        torque *= 1.0 + h.alien_ripple * wave
    if h.alien_dead_time_nm != 0.0:
        torque -= h.alien_dead_time_nm * math.tanh(torque / 0.05)
    if abs(speed) > h.alien_weakening_from:
        torque /= 1.0 + h.alien_weakening * (abs(speed) - h.alien_weakening_from)
    if torque > 0.0:  # one current sensor of two
        torque *= 1.0 + h.late_one_way_gain
    if torque * speed < 0.0:  # what braking feeds back is limited
        torque *= 1.0 - h.late_braking_loss
    if h.late_iron_loss != 0.0:
        torque /= 1.0 + h.late_iron_loss * abs(torque * speed)
    if h.last_power_limit != 0.0:  # what the battery gives is limited
        over = max(torque * speed - h.last_power_limit_w, 0.0)
        torque /= 1.0 + h.last_power_limit * over
    if h.late_magnet_loss != 0.0:
        torque *= 1.0 - h.late_magnet_loss * (1.0 - math.exp(-t / h.late_magnet_s))
    return torque * (1.0 - h.alien_heat_loss * heat)


@kernel
def delayed(past: Floats, tick: int, late: float) -> float:
    """What a ring buffer of past values held ``late`` (not whole) ticks ago."""
    late = min(late, len(past) - 2.0)
    whole = int(late)
    newer, older = past[(tick - whole) % len(past)], past[(tick - whole - 1) % len(past)]
    return newer + (late - whole) * (older - newer)


@kernel
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
