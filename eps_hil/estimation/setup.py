"""The numbers that compiled estimator code works with: constants, physics, inputs."""

import math
from typing import NamedTuple

from eps_hil.estimation import observer_design
from eps_hil.estimation.acting import table_of
from eps_hil.estimation.bristle_setup import filter_constants
from eps_hil.estimation.places import effects_of_places
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.validity import Reason
from eps_hil.physics.effects.added import Added, InUse, added, in_use
from eps_hil.physics.friction import FrictionLaw, friction_law
from eps_hil.physics.model import Model

STEP_S = 1e-3
STEP_NS = 1_000_000


_KEEP_EVERY_S = 0.032
_UNKNOWN_LAGS = 3.0
"""Lags of the output after which it holds nothing of an unknown friction any more."""


class Constants(NamedTuple):
    """All numbers of one set-up, worked out once from model and settings."""

    step_s: float
    inverse_inertia: float
    ratio: float
    sensor_to_rotor: float
    l_phi_phi: float
    l_phi_omega: float
    l_omega_phi: float
    l_omega_omega: float
    l_force_phi: float
    l_force_omega: float
    observer_lag_s: float
    output_lag_s: float
    low_pass: float
    acceleration_low_pass: float
    slope_low_pass: float
    dead_zone: float
    dead_zone_sigma: float
    speed_noise_gain: float
    torque_noise_gain: float
    noise_memory: float
    first_noise: float
    first_drive_noise: float
    first_angle_noise: float
    angle_low_pass: float
    path_forgetting: float
    level_step: float
    use_dead_zone: bool
    angle_seen: bool
    speed_seen: bool
    largest_acceleration: float
    largest_turn: float
    limiter_speed: float
    limiter_acceleration: float
    settle_steps: int
    unknown_limit_n: float
    unknown_steps: int
    keep_steps: int
    compensate: bool
    limit: bool
    angle_measured: bool
    known_force: bool
    memory_keep: float
    always: int
    way_per_noise: float


class Physics(NamedTuple):
    """The model as compiled code takes it: the friction law, and what a diagnosis added to it."""

    law: FrictionLaw
    effects: Added
    use: InUse


def physics_of(model: Model) -> Physics:
    """Friction law and added effects of a model whose own numbers are worked in already."""
    effects = added(model)
    use = in_use(effects)
    return Physics(friction_law(model.friction), table_of(effects, use), use)


class Inputs(NamedTuple):
    """What one step is given, aligned to one physical instant.

    ``rack_force_n`` is used only where the observer is turned around to give the friction.
    ``motor_angle_rad`` is used only with ``position: measured``. The noises are the variances
    of T_1m's, the speed's and the angle's noise where they are known; else they are learnt from
    the inputs themselves. ``speed_periods`` and ``angle_periods``: how many of their periods lie
    between the samples that they were read between, more than one where samples are missing.
    """

    motor_torque_nm: float
    torque_sensor_nm: float
    motor_speed_rad_s: float
    motor_angle_rad: float = 0.0
    rack_force_n: float = 0.0
    drive_noise: float = -1.0
    speed_noise: float = -1.0
    angle_noise: float = -1.0
    speed_periods: float = 1.0
    angle_periods: float = 1.0


def constants(
    model: Model,
    settings: EstimatorSettings,
    angle_seen: bool = False,
    speed_seen: bool = True,
    speed_period_s: float = 0.0,
) -> Constants:
    """Observer gain, filters and thresholds for a model (reads nothing, remembers nothing).

    ``speed_seen``: the speed is measured, not derived from the angle, every ``speed_period_s``, or
    at each step if that is less. ``always``: reason bits that hold at every step;
    ``way_per_noise``: variance (s²) that a step's way has for noise of variance 1.
    """
    measured, step_s = settings.position == "measured", settings.step_s
    obs = observer_design.design(model, settings, angle=measured, speed=True, dt=step_s)
    pole = math.exp(-2 * math.pi * settings.output_low_pass_hz * step_s)
    low_pass = 1.0 - pole if settings.low_pass else 1.0
    filter_lag = 2 * step_s * pole / (1.0 - pole) if settings.low_pass else 0.0
    gain = obs.gain
    lag_s = obs.lag_s + filter_lag
    if settings.kind == "bristle_filter":
        lag_s = step_s * filter_constants(model, settings, step_s, angle_seen).lag
    return Constants(
        step_s=step_s,
        inverse_inertia=1.0 / model.inertia_kg_m2,
        ratio=model.rack_to_rotor_ratio_rad_per_m,
        sensor_to_rotor=model.sensor_to_rotor,
        l_phi_phi=float(gain[0, 0]),
        l_phi_omega=float(gain[0, 1]),
        l_omega_phi=float(gain[1, 0]),
        l_omega_omega=float(gain[1, 1]),
        l_force_phi=float(gain[2, 0]),
        l_force_omega=float(gain[2, 1]),
        observer_lag_s=obs.lag_s,
        output_lag_s=lag_s,
        low_pass=low_pass,
        acceleration_low_pass=smoothing(settings.acceleration_low_pass_hz, step_s),
        slope_low_pass=smoothing(settings.output_low_pass_hz, step_s),
        dead_zone=settings.dead_zone_rad_s,
        dead_zone_sigma=settings.dead_zone_sigma,
        speed_noise_gain=obs.speed_noise_gain,
        torque_noise_gain=obs.torque_noise_gain,
        noise_memory=step_s / settings.noise_memory_s,
        first_noise=settings.speed_noise_rad_s**2,
        first_drive_noise=settings.torque_noise_nm**2,
        first_angle_noise=settings.angle_noise_rad**2,
        angle_low_pass=smoothing(settings.creep_low_pass_hz, step_s),
        path_forgetting=step_s / settings.path_memory_s,
        level_step=step_s * settings.level_slew_nm_per_s,
        use_dead_zone=settings.dead_zone,
        angle_seen=angle_seen,
        speed_seen=speed_seen,
        largest_acceleration=settings.plausibility.largest_acceleration_rad_s2(
            model.rack_to_rotor_ratio_rad_per_m, model.inertia_kg_m2
        ),
        largest_turn=settings.plausibility.largest_turning_rad_s * step_s,
        limiter_speed=settings.limiter_speed_rad_s,
        limiter_acceleration=settings.limiter_acceleration_rad_s2,
        settle_steps=round(settings.settle_s / step_s),
        unknown_limit_n=settings.friction_unknown_n,
        unknown_steps=math.ceil(_UNKNOWN_LAGS * lag_s / step_s),
        keep_steps=round(_KEEP_EVERY_S / step_s),
        compensate=settings.friction_compensation and settings.quantity == "rack_force",
        limit=settings.limiter,
        angle_measured=measured,
        known_force=settings.quantity == "friction",
        memory_keep=_memory_keep(model, step_s),
        always=_always(model, angle_seen),
        way_per_noise=step_s * max(step_s, speed_period_s),
    )


def _always(model: Model, angle_seen: bool) -> int:
    """Nothing is known of the range that an effect of places is in where no angle is measured."""
    blind = not angle_seen and effects_of_places(model)
    return int(Reason.OUT_OF_RANGE if blind else Reason.FINE)


def _memory_keep(model: Model, step_s: float) -> float:
    """Share that a step leaves of what the slowest effect remembers of a time; 0: none does."""
    longest_s = 0.0
    for entry in model.effects:
        for i, memory in enumerate(entry.get("memory", ()), 1):
            if memory in ("lag", "heat"):
                longest_s = max(longest_s, float(entry[f"memory_{i}"]))
    return math.exp(-step_s / longest_s) if longest_s > 0.0 else 0.0


def smoothing(frequency_hz: float, step_s: float) -> float:
    """Weight of the newest sample in a first-order low-pass at the step rate."""
    return 1.0 - math.exp(-2 * math.pi * frequency_hz * step_s)
