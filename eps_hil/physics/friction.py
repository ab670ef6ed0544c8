"""LuGre friction with the load-dependent, asymmetric static level of the seed paper (eq. 2, 3).

All torques are at the rotor, in Nm; speeds at the rotor, in rad/s; the rack force in N at the
rack. The same compiled functions run in the plant, in the estimator and in identification.
"""

import math
from typing import NamedTuple

from eps_hil.compiled import kernel
from eps_hil.physics.model import Friction

SMALLEST_LEVEL_NM = 1e-6
_FADED = 60.0  # exp(−60) of the bristle damping is nothing, and smaller ones are slow to compute


class FrictionLaw(NamedTuple):
    """The nine numbers of table 2 in the order of the model file; what compiled code is given."""

    offset_pos_nm: float
    offset_neg_nm: float
    viscous_pos_nm_s_per_rad: float
    viscous_neg_nm_s_per_rad: float
    load_pos_nm_per_n: float
    load_neg_nm_per_n: float
    sigma0_nm_per_rad: float
    sigma1_nm_s_per_rad: float
    sigma1_speed_rad_s: float


def friction_law(friction: Friction) -> FrictionLaw:
    """The model file's friction block as compiled code takes it."""
    return FrictionLaw(*(float(getattr(friction, name)) for name in FrictionLaw._fields))


@kernel(inline="always")
def static_level_nm(speed_rad_s: float, rack_force_n: float, law: FrictionLaw) -> float:
    """T_fs of eq. 3 (Nm, at the rotor): k0 + kω|ω| + kr|F_r|, by the direction of the speed."""
    speed, load = abs(speed_rad_s), abs(rack_force_n)
    if speed_rad_s >= 0.0:
        level = (
            law.offset_pos_nm + law.viscous_pos_nm_s_per_rad * speed + law.load_pos_nm_per_n * load
        )
    else:
        level = (
            law.offset_neg_nm + law.viscous_neg_nm_s_per_rad * speed + law.load_neg_nm_per_n * load
        )
    return max(level, SMALLEST_LEVEL_NM)


@kernel(inline="always")
def bristle_step(
    bristle_rad: float, travel_rad: float, slip_rad: float, level_nm: float, sigma0: float
) -> float:
    """Bristle deflection z after one step: the exact solution of eq. 2a for held ω and T_fs.

    ``travel_rad`` is the signed rotor displacement of the step (ω Δt), ``slip_rad`` the path that
    wears the bristle down (|ω| Δt; smaller, or zero, where speed is only sensor noise). With
    slip = |travel| this is z⁺ = z_ss + (z − z_ss) exp(−|ω| σ0 Δt / T_fs), stable for every step.
    """
    decay = slip_rad * sigma0 / level_nm
    # (1 − e^−d)/d tends to 1 − d/2: the bristle then simply follows the rotor.
    lost = -math.expm1(-decay)
    share = lost / decay if decay > 1e-9 else 1.0 - 0.5 * decay
    return bristle_rad * (1.0 - lost) + travel_rad * share


@kernel(inline="always")
def friction_torque_nm(
    bristle_rad: float, speed_rad_s: float, level_nm: float, law: FrictionLaw
) -> float:
    """T_f of eq. 2d (Nm, opposes positive speed): σ0 z + σ1(ω) ż with ż of eq. 2a, σ1 of eq. 2c."""
    ratio = speed_rad_s / law.sigma1_speed_rad_s
    if ratio * ratio > _FADED or law.sigma1_nm_s_per_rad == 0.0:
        return law.sigma0_nm_per_rad * bristle_rad
    sigma1 = law.sigma1_nm_s_per_rad * math.exp(-ratio * ratio)
    rate = speed_rad_s - abs(speed_rad_s) * law.sigma0_nm_per_rad * bristle_rad / level_nm
    return law.sigma0_nm_per_rad * bristle_rad + sigma1 * rate
