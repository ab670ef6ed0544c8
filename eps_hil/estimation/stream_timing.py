"""Which signals a stream reads, how late each is, and how far back everything has arrived."""

import math
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.estimation.plausibility import limits_of
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.watch import Limits
from eps_hil.physics.model import Model
from eps_hil.signals import ESTIMATOR_INPUTS

SIGNALS = (*ESTIMATOR_INPUTS, "rack_force_n")
TORQUE, SENSOR, SPEED, ANGLE, FORCE = range(5)

Int64 = npt.NDArray[np.int64]
Float64 = npt.NDArray[np.float64]

MISSING_PERIODS = 1.6
"""Samples so many periods apart have lost one between them."""
_FIRST_SAMPLES = 50.0
"""Of so many samples the settings' noise figures are taken to be, before any was seen."""


class Timing(NamedTuple):
    """Per signal, in ns: delay, age beyond which it is lost, neighbours between which some are
    missing, whether it is used; then look-back.

    ``first_noise``: per signal the variance that its noise is first taken to have, and of how many
    samples that counts; ``noise_memory`` (ns): over how long it is then averaged.
    """

    delay: Int64
    stale: Int64
    missing: Int64
    used: npt.NDArray[np.bool_]
    step_ns: int
    lookback: int
    speed_window: int
    limits: Limits
    first_noise: Float64
    noise_memory: float


def timing_of(
    model: Model,
    settings: EstimatorSettings,
    periods_s: Mapping[str, float],
    also: Collection[str] = (),
) -> Timing:
    """Which signals are read, how late each is, and how far back everything has arrived.

    ``also``: signals beside the estimator's own, where they come. ``ValueError`` for what it lacks.
    """
    derive = "motor_speed_rad_s" not in periods_s
    needed = {"motor_torque_nm", "motor_angle_rad" if derive else "motor_speed_rad_s"}
    if settings.quantity == "friction":
        needed.add("rack_force_n")
    if settings.position == "measured":
        needed.add("motor_angle_rad")
    missing = sorted(needed - set(periods_s))
    if missing:
        if derive and "motor_angle_rad" in missing:
            missing[missing.index("motor_angle_rad")] = "motor_speed_rad_s or motor_angle_rad"
        raise ValueError(f"the estimator needs {', '.join(missing)}")
    used = np.array([name in {*needed, *also, "torque_sensor_nm"} for name in SIGNALS])
    used &= np.array([name in periods_s for name in SIGNALS])
    used[SPEED] = True
    used[ANGLE] = "motor_angle_rad" in periods_s
    window = 0.0
    periods = [periods_s.get(name, 0.0) for name in SIGNALS]
    delays = [model.delays_s.of(name) for name in SIGNALS]
    if derive:
        periods[SPEED], delays[SPEED] = periods[ANGLE], delays[ANGLE]
        window = max(settings.speed_window_s, 2.5 * periods[ANGLE])  # three samples, surely
    ahead = [d + p + _margin_s(p, settings.step_s) for d, p in zip(delays, periods, strict=True)]
    ahead[SPEED] += window / 2
    lookback = max(a for a, use in zip(ahead, used, strict=True) if use)
    stale = [max(settings.stale_after_s, 3 * p) + window * (i == SPEED)
             for i, p in enumerate(periods)]  # fmt: skip
    torque = settings.torque_noise_nm
    sensor = torque / model.sensor_to_rotor
    first = (torque, sensor, settings.speed_noise_rad_s, settings.angle_noise_rad, 0.0)
    return Timing(
        np.array([round(d * 1e9) for d in delays], np.int64),
        np.array([round(s * 1e9) for s in stale], np.int64),
        np.array([round(MISSING_PERIODS * p * 1e9) for p in periods], np.int64),
        used,
        settings.step_ns,
        round(lookback * 1e9),
        round(window * 1e9) if derive else 0,
        limits_of(model, settings, bool(used[ANGLE]) and not derive),
        np.array([[sigma**2, _FIRST_SAMPLES] for sigma in first]),
        settings.noise_memory_s * 1e9,
    )


def _margin_s(period_s: float, step_s: float) -> float:
    """How much later than its period a sample may arrive without being missed; whole steps.

    Signals at the estimator's own rate come in the sender's cycle and need none; slower ones are
    stamped on arrival, behind whatever else the bus carried.
    """
    return math.ceil(period_s / 4 / step_s) * step_s if period_s > 2 * step_s else 0.0
