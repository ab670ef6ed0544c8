"""One millisecond of the rig with its bristle as a state: transition and Jacobian (eq. 1d, 2, 3).

State [φ, ω, z, F_r, Ḟ_r]: rotor angle (rad), rotor speed (rad/s), bristle deflection (rad, at the
rotor), rack force (N, at the rack) and its rate (N/s). Where the paper's observer is handed the
friction torque from outside, here the friction is part of the motion that is estimated: what the
rotor does next tells of the bristle, and the uncertainty of the one is that of the other.

The step is the midpoint rule with the bristle's exact solution inside: the speed half way drives
eq. 2a, the mean of z carries σ0, and (z⁺ − z)/Δt is the exact mean of ż that carries σ1.
"""

import math
from typing import NamedTuple

from eps_hil.compiled import kernel
from eps_hil.estimation.bristle_setup import BRISTLE, FORCE, OMEGA, PHI, RATE, Drive, Floats
from eps_hil.physics.friction import SMALLEST_LEVEL_NM, FrictionLaw

_SHORT = 1e-6
_FADED = 60.0


class Step(NamedTuple):
    """What one step is driven by.

    ``torque_nm``: mean T_1m over the step, less added torques; ``extra_level_nm``: what effects
    add to T_fs. Slower than ``slip_from_rad_s`` the path that wears the bristle is not the speed's
    (noise has a path too) but that of ``held_rad``, which follows the angle at a distance of
    ``gap_rad``.
    """

    torque_nm: float
    extra_level_nm: float
    slip_from_rad_s: float
    held_rad: float
    gap_rad: float


@kernel
def _level(
    law: FrictionLaw, direction: float, speed: float, force: float, extra: float
) -> tuple[float, float, float]:
    """T_fs (Nm) of eq. 3 for a direction, and its derivatives by speed and by rack force."""
    sign = 1.0 if speed >= 0.0 else -1.0
    side = 1.0 if force >= 0.0 else -1.0
    if direction >= 0.0:
        offset, viscous, load = (
            law.offset_pos_nm,
            law.viscous_pos_nm_s_per_rad,
            law.load_pos_nm_per_n,
        )
    else:
        offset, viscous, load = (
            law.offset_neg_nm,
            law.viscous_neg_nm_s_per_rad,
            law.load_neg_nm_per_n,
        )
    level = offset + viscous * abs(speed) + load * abs(force) + extra
    if level < SMALLEST_LEVEL_NM:
        return SMALLEST_LEVEL_NM, 0.0, 0.0
    return level, viscous * sign, load * side


@kernel
def _damping(law: FrictionLaw, speed: float) -> tuple[float, float]:
    """σ1 of eq. 2c (Nm s/rad) and its derivative by speed."""
    part = speed / law.sigma1_speed_rad_s
    if part * part > _FADED:
        return 0.0, 0.0
    value = law.sigma1_nm_s_per_rad * math.exp(-part * part)
    return value, -2.0 * part / law.sigma1_speed_rad_s * value


@kernel
def transition(  # noqa: PLR0915
    d: Drive, law: FrictionLaw, u: Step, x: Floats, jacobian: Floats
) -> tuple[float, float]:
    """Move ``x`` (5,) on by a step, write ∂x⁺/∂x into ``jacobian`` (5, 5).

    Returns the mean T_f of the step (Nm) and the held angle after it (rad). The Jacobian holds
    wherever the direction of slip does not change inside the step. One function on purpose: value
    and derivative of each line stand side by side.
    """
    dt, per_inertia = d.step_s, d.inverse_inertia
    omega, z = x[OMEGA], x[BRISTLE]
    force = x[FORCE] + 0.5 * dt * x[RATE]  # mean over the step
    s0 = law.sigma0_nm_per_rad
    direction = omega if abs(omega) > u.slip_from_rad_s else z
    # Speed half way, with the friction of the beginning.
    level, level_w, level_f = _level(law, direction, omega, force, u.extra_level_nm)
    s1, s1_w = _damping(law, omega)
    sign = 1.0 if omega >= 0.0 else -1.0
    wears = abs(omega) > u.slip_from_rad_s
    worn = sign * omega * s0 / level if wears else 0.0
    zdot = omega - worn * z
    zdot_w, zdot_f = 1.0, 0.0
    if wears:
        zdot_w += -sign * s0 * z / level + worn * z * level_w / level
        zdot_f = worn * z * level_f / level
    h = 0.5 * dt * per_inertia
    half = omega + h * (u.torque_nm - force / d.ratio - s0 * z - s1 * zdot)
    half_w = 1.0 - h * (s1 * zdot_w + s1_w * zdot)
    half_z = -h * (s0 - s1 * worn)
    half_f = -h * (1.0 / d.ratio + s1 * zdot_f)
    # The bristle over the step, at that speed.
    direction = half if abs(half) > u.slip_from_rad_s else z
    sign = 1.0 if half >= 0.0 else -1.0
    level, level_w, level_f = _level(law, direction, half, force, u.extra_level_nm)
    travel = half * dt
    slides = abs(half) > u.slip_from_rad_s
    decay, kept, share, steeper = 0.0, 1.0, 1.0, -0.5
    if slides:
        decay = sign * travel * s0 / level
        kept = math.exp(-decay)
        if decay > _SHORT:
            share = -math.expm1(-decay) / decay
            steeper = (kept - share) / decay
        else:
            share = 1.0 - 0.5 * decay
    after = z * kept + travel * share
    by_decay = travel * steeper - z * kept if slides else 0.0
    decay_w = sign * dt * s0 / level - decay / level * level_w
    after_w = dt * share + by_decay * decay_w
    after_z = kept + after_w * half_z
    after_f = after_w * half_f - by_decay * decay / level * level_f
    after_w *= half_w
    # A resting bristle bends no further than it can.
    limit = max(level / s0, abs(z))
    if not slides and abs(after) > limit:
        side = 1.0 if after >= 0.0 else -1.0
        after = side * limit
        if limit > level / s0:
            after_w, after_z, after_f = 0.0, 1.0 if side * z > 0.0 else -1.0, 0.0
        else:
            after_w = side * level_w * half_w / s0
            after_z = side * level_w * half_z / s0
            after_f = side * (level_w * half_f + level_f) / s0
    # The rotor, with the mean friction of the step.
    s1, s1_w = _damping(law, half)
    mean_zdot = (after - z) / dt
    friction = 0.5 * s0 * (z + after) + s1 * mean_zdot
    stiff = 0.5 * s0 + s1 / dt
    friction_w = stiff * after_w + s1_w * mean_zdot * half_w
    friction_z = stiff * after_z + 0.5 * s0 - s1 / dt + s1_w * mean_zdot * half_z
    friction_f = stiff * after_f + s1_w * mean_zdot * half_f
    g = dt * per_inertia
    omega_w, omega_z = 1.0 - g * friction_w, -g * friction_z
    omega_f = -g * (1.0 / d.ratio + friction_f)
    moved = omega + g * (u.torque_nm - force / d.ratio - friction)
    x[PHI] += 0.5 * dt * (omega + moved)
    # What creep there is wears the bristle too; noise has no path beyond the gap.
    held = min(max(u.held_rad, x[PHI] - u.gap_rad), x[PHI] + u.gap_rad)
    if not slides:
        worn = math.exp(-abs(held - u.held_rad) * s0 / level)
        after, after_w, after_z, after_f = (
            worn * after,
            worn * after_w,
            worn * after_z,
            worn * after_f,
        )
    x[OMEGA], x[BRISTLE] = moved, after
    x[FORCE] += dt * x[RATE]
    x[RATE] *= d.rate_kept
    j = jacobian
    j[:, :] = 0.0
    j[PHI, PHI] = 1.0
    j[PHI, OMEGA], j[PHI, BRISTLE] = 0.5 * dt * (1.0 + omega_w), 0.5 * dt * omega_z
    j[PHI, FORCE], j[PHI, RATE] = 0.5 * dt * omega_f, 0.25 * dt * dt * omega_f
    j[OMEGA, OMEGA], j[OMEGA, BRISTLE], j[OMEGA, FORCE] = omega_w, omega_z, omega_f
    j[OMEGA, RATE] = 0.5 * dt * omega_f
    j[BRISTLE, OMEGA], j[BRISTLE, BRISTLE], j[BRISTLE, FORCE] = after_w, after_z, after_f
    j[BRISTLE, RATE] = 0.5 * dt * after_f
    j[FORCE, FORCE], j[FORCE, RATE] = 1.0, dt
    j[RATE, RATE] = d.rate_kept
    return friction, held
