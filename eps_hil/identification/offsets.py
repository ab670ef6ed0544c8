"""A constant error of a torque sensor, from stretches in which nothing drives it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eps_hil.identification import filters
from eps_hil.identification.balance import Case
from eps_hil.identification.zero_torque import WINDOW_S, readings

MOST_NM = {"torque_sensor_nm": 0.5, "motor_torque_nm": 0.05}
"""A reading beyond this is a torque, not an offset."""
FEWEST = 3
"""Windows; the interval of so few is wide, by Student's t."""


@dataclass(frozen=True)
class Offset:
    """What a signal reads (Nm) with no torque on it: value, 95 % interval, seconds looked at."""

    value: float
    ci95: tuple[float, float]
    seconds: float


def offset(cases: Sequence[Case], signal: str, rotor_per_wheel: float) -> Offset | None:
    """The offset of ``signal`` from windows in which nothing drives it; None without such.

    ``rotor_per_wheel``: rad of the rotor per rad of the steering wheel.
    """
    found = [reading for case in cases for reading in _windows(case, signal, rotor_per_wheel)]
    if len(found) < FEWEST:
        return None
    from scipy.stats import t

    values = np.array(found)
    middle = float(np.median(values))
    spread = float(np.std(values, ddof=1))
    if abs(middle) > MOST_NM[signal] or spread > 0.2 * MOST_NM[signal]:
        return None
    half = float(t.ppf(0.975, len(values) - 1)) * spread / np.sqrt(len(values))
    mean = float(values.mean())
    return Offset(mean, (mean - half, mean + half), len(values) * WINDOW_S)


def _windows(case: Case, signal: str, rotor_per_wheel: float) -> list[float]:
    if not case.recording.has(signal):
        return []
    noise = float(np.sqrt(case.recording.density[signal] / (2 * filters.STEP_S)))
    wheel = rotor_per_wheel if signal == "torque_sensor_nm" else None
    values, good = case.recording.raw[signal], case.recording.good
    return readings(values, case.motion.speed, good, noise, wheel)
