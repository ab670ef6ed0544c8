"""What a true rig is made of: its drive, its masses, and the physics hidden in it.

Torques, angles and inertias are at the rotor (CONTRACT 1) unless the name says otherwise; the
numbers of :class:`Drive` are the seed paper's (table 2) and the nominal drive of the reference
rig, written down here a second time so that the proof depends on nobody's model file.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

MOTOR_LAG_S = 0.0007
NUT_NM_PER_RAD = 300.0
"""Stiffness of the ball nut on its screw, at the rotor."""
"""Current loop; it also makes the reported torque smooth, so that a sample speaks of an instant."""


class Drive(NamedTuple):
    """Inertia, ratios and friction that the model file knows about (eq. 1 to 3)."""

    inertia_kg_m2: float = 2.0e-4
    pinion_rad_per_m: float = 125.7
    rack_rad_per_m: float = 2513.0
    belt_ratio: float = 2.8
    pole_pairs: float = 4.0
    k0_pos: float = 5.600e-2
    k0_neg: float = 1.258e-1
    kw_pos: float = 4.195e-4
    kw_neg: float = 6.658e-5
    kr_pos: float = 4.993e-5
    kr_neg: float = 4.345e-5
    sigma0: float = 4.5
    sigma1: float = 0.075
    sigma1_speed: float = 0.75


class Hidden(NamedTuple):
    """Strength and shape of what the model file does not know; the defaults change nothing.

    Equations: CONTRACT 8. Names that start with ``alien`` or ``late`` are physics outside that
    catalogue; the late ones were written before a diagnosis had seen them.
    """

    stribeck_nm: float = 0.0
    stribeck_speed: float = 10.0
    viscous: float = 0.0
    quadratic: float = 0.0
    load_gain: float = 0.0
    half_difference_nm: float = 0.0
    place_nm: float = 0.0
    place_centre_m: float = 0.0
    place_width_m: float = 0.01
    dwell_nm: float = 0.0
    dwell_time_s: float = 1.0
    dwell_release_rad: float = 0.5
    warmup: float = 0.0
    warmup_time_s: float = 20.0
    coulomb_scale: float = 1.0
    screw_nm: float = 0.0
    screw_phase: float = 0.0
    screw_harmonic: float = 1.0
    cogging_nm: float = 0.0
    cogging_order: float = 8.0
    cogging_phase: float = 0.0
    ripple: float = 0.0
    ripple_phase: float = 0.0
    cardan: float = 0.0
    cardan_phase: float = 0.0
    saturation: float = 0.0
    motor_gain: float = 1.0
    motor_offset_nm: float = 0.0
    motor_late_s: float = 0.0
    spring: float = 0.0
    stop_at_m: float = 1.0e3
    stop_n_per_m: float = 0.0
    static_nm: float = 0.0
    static_centre_m: float = 0.0
    static_width_m: float = 0.01
    alien_eddy_nm: float = 0.0
    alien_eddy_speed: float = 30.0
    alien_load_memory: float = 0.0
    alien_load_memory_s: float = 2.0
    alien_load_ripple: float = 0.0
    alien_load_ripple_order: float = 0.61
    alien_heat_loss: float = 0.0
    alien_heat_s: float = 10.0
    alien_iron_play_nm: float = 0.0
    alien_one_way_drag: float = 0.0
    alien_dead_time_nm: float = 0.0
    alien_weakening: float = 0.0
    alien_weakening_from: float = 30.0
    alien_driven_loss: float = 0.0
    alien_unbalance: float = 0.0
    alien_unbalance_phase: float = 0.0
    alien_guide: float = 0.0
    alien_speed_memory: float = 0.0
    alien_speed_memory_s: float = 0.5
    alien_ripple: float = 0.0
    alien_ripple_order: float = 5.0
    alien_ripple_phase: float = 0.0
    alien_bushing_nm: float = 0.0
    alien_bushing_rad: float = 2.0
    alien_travel_drag: float = 0.0
    alien_thinning: float = 0.0
    alien_thinning_s: float = 10.0
    alien_thrust: float = 0.0
    alien_thrust_from_n: float = 300.0
    late_nut_loss: float = 0.0
    late_seal_nm: float = 0.0
    late_seal_n: float = 300.0
    late_film: float = 0.0
    late_film_s: float = 0.3
    late_film_peak_nm: float = 0.0
    late_film_peak_at: float = 20.0
    late_film_peak_wide: float = 6.0
    late_worn_tooth_nm: float = 0.0
    late_worn_tooth_order: float = 7.0
    late_worn_tooth_wide_m: float = 0.004
    late_wet_drag: float = 0.0
    late_wet_drag_s: float = 0.3
    late_one_way_gain: float = 0.0
    late_braking_loss: float = 0.0
    late_iron_loss: float = 0.0
    late_magnet_loss: float = 0.0
    late_magnet_s: float = 10.0
    last_column_rub: float = 0.0
    last_screw_travel: float = 0.0
    last_fading_cogging_nm: float = 0.0
    last_fading_cogging_order: float = 8.0
    last_fading_cogging_speed: float = 12.0
    last_power_limit: float = 0.0
    last_power_limit_w: float = 4.0


class Chain(NamedTuple):
    """Masses of the drive from rotor to load, all reflected to the rotor, joined in a row.

    ``inertia`` (n,), ``stiffness`` and ``damping`` (n-1,) of the joints; the pinion sits on mass
    ``rack``, the rack force acts on the last one, friction on mass ``rubs``: the rotor, where
    eq. 1d is exact, or what lies behind a gap or a soft belt.
    ``gap_rad`` is the whole width of a dead zone in the last joint before the rack.
    ``wheel_inertia`` 0 leaves the steering wheel out: the hand torque then is the sensor's.
    """

    inertia: Floats
    stiffness: Floats
    damping: Floats
    rack: int
    gap_rad: float
    wheel_inertia: float
    bar_stiffness: float
    bar_damping: float
    motor_lag_s: float
    rubs: int = 0


class Slip(NamedTuple):
    """Friction elements, all (m,): shares of the sliding level, and stiffness in units of σ0.

    The shares of the level add up to 1. No elements (m = 0) means a plain LuGre bristle.
    """

    level_share: Floats
    stiffness: Floats


def lugre() -> Slip:
    """The model file's own form of friction."""
    return Slip(np.zeros(0), np.zeros(0))


def maxwell_slip(breaks: tuple[float, ...] = (0.2, 0.5, 0.9, 1.5, 2.4, 4.0)) -> Slip:
    """Elements that reverse from sliding along a LuGre bristle's curve, 2 T_fs (1 − e^−u).

    With other levels each way the curve has one length, (T + T')/2σ0, where LuGre's has two.

    ``breaks``: distances u from the reversal, in units of T_fs/σ0, where the elements begin to
    slip; between them the curve is straight. By Masing's rule the virgin curve is that of the
    reversal at half its size, so it starts out twice as stiff as LuGre's; inner loops close,
    and small ones dissipate less. That is the presliding detail in which this rig and the
    model file's form differ; sliding friction is the same.
    """
    u = np.array((0.0, *breaks))
    curve = 1.0 - np.exp(-u)
    curve /= curve[-1]
    virgin = 0.5 * u
    slopes = np.append(np.diff(curve) / np.diff(virgin), 0.0)
    stiffness = slopes[:-1] - slopes[1:]
    return Slip(stiffness * virgin[1:], stiffness)


def one_mass(drive: Drive) -> Chain:
    """Everything rigid; the torsion-bar torque is prescribed."""
    rigid = np.zeros(0)
    return Chain(np.array([drive.inertia_kg_m2]), rigid, rigid, 0, 0.0, 0.0, 0.0, 0.0, MOTOR_LAG_S)


def two_masses(drive: Drive, stiffness: float, damping: float, gap_rad: float = 0.0) -> Chain:
    """Rotor, and everything behind the belt; J_1m stays what it is."""
    rotor = 0.67 * drive.inertia_kg_m2
    return Chain(
        np.array([rotor, drive.inertia_kg_m2 - rotor]),
        np.array([stiffness]),
        np.array([damping]),
        1,
        gap_rad,
        0.0,
        0.0,
        0.0,
        MOTOR_LAG_S,
    )


def five_masses(
    drive: Drive, belt_nm_per_rad: float = 400.0, belt_damping: float = 0.02, gap_rad: float = 0.0
) -> Chain:
    """Steering wheel, rotor, ball nut, rack, road wheels; eq. 1b holds for the sum.

    Belt, screw and tie rods are stiffer than a real rig's, so that with nothing hidden the
    one-mass model is right to below the noise; ``belt_nm_per_rad`` is what an effect softens.
    """
    j = drive.inertia_kg_m2
    share = np.array([0.67, 0.24, 0.03, 0.06])
    return Chain(
        share * j,
        np.array([belt_nm_per_rad, NUT_NM_PER_RAD, 200.0]),
        np.array([belt_damping, 0.01, 0.01]),
        2,
        gap_rad,
        0.04,
        115.0,
        0.25,
        MOTOR_LAG_S,
    )
