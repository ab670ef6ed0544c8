"""How the estimator is set up: blocks on or off, thresholds, noise, filters. All have defaults."""

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, with_config

from eps_hil.series import Pace

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]

SHORTEST_STEP_S = 1e-4


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class BristleSettings:
    """Settings of the bristle filter and smoother; sensor noise is the estimator's own.

    The rack force's rate wanders by ``rate_walk_n_per_s_per_sqrt_s`` and forgets itself within
    ``rate_memory_s``, and the force wanders by ``force_walk_n_per_sqrt_s`` beside it.
    """

    force_walk_n_per_sqrt_s: NotNegative = 30.0
    rate_walk_n_per_s_per_sqrt_s: Positive = 2e4
    rate_memory_s: Positive = 0.1
    lag_s: Annotated[float, Field(ge=0, le=0.06)] = 0.017
    """How far the filter looks back over what it has seen; as much as the paper's own lag."""
    slip_sigma: NotNegative = 3.0
    """Speeds below as many of the filter's own standard deviations count as rest or creep."""
    slip_least_rad_s: NotNegative = 0.02
    gap_rad: NotNegative = 1.8e-3
    """Path of a resting rotor that wears no bristle: the noise of the observed angle."""
    gap_without_angle_rad: NotNegative = 5e-3
    """The same where no angle is measured."""


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class PlausibilitySettings:
    """What a signal, several together, and the estimate can be (docs/theory-estimator.md)."""

    enabled: bool = True
    estimate_n: Positive = 15_000.0
    """Largest rack force that is believed."""
    motor_torque_nm: NotNegative = 0.0
    """Largest motor torque; 0: 1.2 times what ``estimate_n`` takes at the rotor. Set it to what
    the motor can make."""
    torque_sensor_nm: Positive = 30.0
    motor_speed_rad_s: Positive = 1500.0
    frozen_samples: Annotated[int, Field(ge=2)] = 5
    """So many equal samples of a signal that is hardly ever equal, while the rotor moves."""
    jump_chi_square: Positive = 37.0
    """Limit of the normalised innovation squared after a torque jump (37: 1e-9 of a chi-square)."""
    unseen_s: NotNegative = 0.75
    """How long after missing inputs, or a jump of time, a torque that may have begun to be wrong
    unseen is waited for: only its end shows."""
    consistent_s: Positive = 10.0
    """How long after a jump that no motion followed the torque is doubted, if it does not jump
    back."""

    def largest_torque_nm(self, ratio: float) -> float:
        """At the rotor, which turns ``ratio`` rad per metre of the rack."""
        return self.motor_torque_nm or 1.2 * self.estimate_n / ratio

    def largest_acceleration_rad_s2(self, ratio: float, inertia_kg_m2: float) -> float:
        """Of the rotor, by three such torques: motor, driver and rack."""
        return 3.0 * self.largest_torque_nm(ratio) / inertia_kg_m2

    @property
    def largest_turning_rad_s(self) -> float:
        """What an angle's samples may turn by, before one of them is refused."""
        return 2.0 * self.motor_speed_rad_s


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """Settings of the rack-force estimator (PAPER fig. 8); torques and speeds at the rotor.

    The observer's bandwidth follows from the noise figures: ``force_walk_n_per_sqrt_s`` is how
    fast the rack force may wander, ``speed_noise_rad_s`` how noisy one speed sample is; a larger
    ratio is a faster and noisier estimate.
    """

    kind: Literal["observer", "bristle_filter", "smoother"] = "observer"
    """The paper's estimator; the Kalman filter with the bristle inside; the same over a whole
    recording, forth and back (not live). docs/theory-second-estimator.md says which is when."""
    bristle: BristleSettings = field(default_factory=BristleSettings)
    plausibility: PlausibilitySettings = field(default_factory=PlausibilitySettings)

    friction_compensation: bool = True
    """Subtract the friction model's torque (2Q-fa); off shows 'w/o FC' of figs 10 to 12."""
    dead_zone: bool = True
    """Below ``dead_zone_rad_s`` speed is taken as sensor noise (one of the two 'extensions')."""
    limiter: bool = True
    """Eq. 4a at standstill (the other extension)."""
    low_pass: bool = True
    """The output filter of fig. 8."""
    quantity: Literal["rack_force", "friction"] = "rack_force"
    """What the observer is asked for; 'friction' needs the rack force as an input (fig. 9), gives
    NaN for it, and is not run live."""
    position: Literal["integrated", "measured"] = "integrated"
    """Whether the observer also corrects on a measured rotor angle (y of eq. 5 to 9)."""

    dead_zone_rad_s: NotNegative = 0.1
    """Least half width of the dead zone."""
    dead_zone_sigma: NotNegative = 4.5
    """Half width in standard deviations of the observed speed, from the noise that is there."""
    noise_memory_s: Positive = 1.0
    """Over how long the speed signal's noise is averaged (from its second differences)."""
    creep_low_pass_hz: Positive = 20.0
    """Filter of the measured angle whose creep bends the resting bristle."""
    path_memory_s: Positive = 0.2
    """How much of the path inside the dead zone counts once the rotor leaves it (no angle)."""

    limiter_speed_rad_s: NotNegative = 1.0
    """SP_A of eq. 4a."""
    limiter_acceleration_rad_s2: NotNegative = 150.0
    """SP_B of eq. 4a."""
    acceleration_low_pass_hz: Positive = 20.0
    """Filter of the differentiated speed that SP_B is compared with."""

    force_walk_n_per_sqrt_s: Positive = 100.0
    speed_noise_rad_s: Positive = 0.3
    angle_noise_rad: Positive = 2e-3
    torque_noise_nm: Positive = 5e-3
    output_low_pass_hz: Positive = 40.0

    level_slew_nm_per_s: Positive = 0.005
    """How fast adapted friction levels are taken over: 0.005 Nm/s are 13 N/s at the reference
    rig's rack, so that no step shows in the published force."""

    speed_window_s: Positive = 0.02
    """Window of the straight line that gives a speed where only the angle is measured."""
    settle_s: NotNegative = 0.15
    """How long inputs must be good before the estimate is called valid again."""
    memory_at_start: Literal["unknown", "none"] | None = None
    """What effects with a memory, as a motor's heat, remember at the start: nobody knows, so that
    the friction is unknown until it has faded; or nothing (a motor that has cooled). By itself:
    'unknown' for a service, 'none' for a recording."""
    friction_unknown_n: Positive = 25.0
    """By how much the rack force may be off because the bristle's history is unknown (a start, a
    gap) and be called valid; a large number: it never counts. docs/theory-estimator.md"""
    stale_after_s: Positive = 0.02
    """An input older than this (and than 3 of its periods) is lost."""
    step_s: Annotated[float, Field(ge=SHORTEST_STEP_S, le=1e-3)] = 1e-3
    """The grid on which it steps; taken from the sync frame where that comes more often than once
    a millisecond. All times above are seconds, whatever the step."""

    @property
    def step_ns(self) -> int:
        """The step in whole nanoseconds."""
        return round(self.step_s * 1e9)


def problem(settings: EstimatorSettings, *, live: bool = True) -> str:
    """Why these settings cannot be used together (or not ``live``); empty if they can."""
    if settings.kind == "observer":
        return ""
    if live and settings.kind == "smoother":
        return "estimator kind 'smoother' needs the whole recording; live, use 'bristle_filter'"
    if settings.quantity == "friction":
        return f"estimator kind '{settings.kind}' gives the rack force only; use 'observer'"
    if not settings.friction_compensation:
        return f"estimator kind '{settings.kind}' has its friction inside; use 'observer'"
    return ""


def at_pace(settings: EstimatorSettings, pace: Pace | None) -> EstimatorSettings:
    """What a log's mapping says goes before: a derived speed's window, a fast sync frame's cycle.

    One rule for the service, and for whoever estimates from its logs.
    """
    window_s, cycle_s = pace or Pace()
    if window_s is not None:
        settings = replace(settings, speed_window_s=window_s)
    if cycle_s is not None and cycle_s < settings.step_s:
        settings = replace(settings, step_s=cycle_s * math.ceil(SHORTEST_STEP_S / cycle_s - 1e-9))
    return settings
