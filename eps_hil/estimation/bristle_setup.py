"""Numbers and memory of the bristle filter: worked out once, no physics and no I/O here."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.physics.model import Model

PHI, OMEGA, BRISTLE, FORCE, RATE = range(5)
"""The filter's states: φ (rad), ω (rad/s), z (rad), F_r (N at the rack), Ḟ_r (N/s)."""
SIZE = 5
LAG_STEPS = 600
"""Longest fixed lag, in steps."""

Floats = npt.NDArray[np.float64]


class Drive(NamedTuple):
    """Numbers of the transition: step (s), 1/J (1/kg m²), i_APA (rad/m), what Ḟ keeps a step."""

    step_s: float
    inverse_inertia: float
    ratio: float
    rate_kept: float


class FilterConstants(NamedTuple):
    """Noise as variances a step, gates, and how many steps the output looks back.

    ``speed_variance`` (rad/s)², ``angle_variance`` rad², ``torque_speed``: what the torque's noise
    (rms) does to ω in a step (rad/s); ``force_variance`` N², ``rate_variance`` (N/s)²;
    ``rate_start`` is the variance that Ḟ settles at.
    """

    drive: Drive
    speed_variance: float
    angle_variance: float
    torque_speed: float
    force_variance: float
    rate_variance: float
    rate_start: float
    slip_sigma: float
    slip_least_rad_s: float
    gap_rad: float
    lag: int
    angle: bool


class Belief(NamedTuple):
    """What the filter believes, and what a smoother needs of the last step; arrays only.

    ``mean`` (5,), ``cov`` (5, 5); ``jacobian`` (5, 5), ``gain`` (2, 5), ``innovation`` (2,) and
    ``spread`` (2,), its variance, each for [speed, angle]; ``ring`` (LAG + 1,): rack force of the
    last steps given all that came since; ``ring_cov`` (LAG + 1, 5): its covariance with the
    present state; ``extra`` (3,): what added effects make of T_fs, and their torque (Nm),
    and dφ/dx over i_APA, by which a force is larger than ``mean`` has it for mid travel;
    ``place``: steps since the start, and 1 where the last step was a start.
    """

    mean: Floats
    cov: Floats
    jacobian: Floats
    gain: Floats
    innovation: Floats
    spread: Floats
    ring: Floats
    ring_cov: Floats
    extra: Floats
    scratch: Floats
    place: npt.NDArray[np.int64]


def new_belief() -> Belief:
    """Memory before the first step."""
    return Belief(
        np.zeros(SIZE),
        np.zeros((SIZE, SIZE)),
        np.zeros((SIZE, SIZE)),
        np.zeros((2, SIZE)),
        np.zeros(2),
        np.ones(2),
        np.zeros(LAG_STEPS + 1),
        np.zeros((LAG_STEPS + 1, SIZE)),
        np.array([0.0, 0.0, 1.0]),
        np.zeros((SIZE, SIZE)),
        np.zeros(2, np.int64),
    )


def filter_constants(
    model: Model, settings: EstimatorSettings, step_s: float, angle_seen: bool
) -> FilterConstants:
    """Constants of the filter for a model (reads nothing, remembers nothing)."""
    chosen = settings.bristle
    kept = math.exp(-step_s / chosen.rate_memory_s)
    rate_variance = chosen.rate_walk_n_per_s_per_sqrt_s**2 * step_s
    return FilterConstants(
        drive=Drive(step_s, 1.0 / model.inertia_kg_m2, model.rack_to_rotor_ratio_rad_per_m, kept),
        speed_variance=settings.speed_noise_rad_s**2,
        angle_variance=settings.angle_noise_rad**2,
        torque_speed=step_s / model.inertia_kg_m2 * settings.torque_noise_nm,
        force_variance=chosen.force_walk_n_per_sqrt_s**2 * step_s,
        rate_variance=rate_variance,
        rate_start=rate_variance / (1.0 - kept * kept),
        slip_sigma=chosen.slip_sigma,
        slip_least_rad_s=chosen.slip_least_rad_s,
        gap_rad=chosen.gap_rad if angle_seen else chosen.gap_without_angle_rad,
        lag=min(round(chosen.lag_s / step_s), LAG_STEPS),
        angle=angle_seen,
    )
