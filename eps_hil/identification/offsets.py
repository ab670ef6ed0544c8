"""A constant error of a torque sensor, from stretches in which nothing drives it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.identification import filters
from eps_hil.identification.balance import Case
from eps_hil.identification.zero_torque import Reading, windows

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MOST_NM = {"torque_sensor_nm": 0.5, "motor_torque_nm": 0.05}
"""A reading beyond this is a torque, not an offset."""
FEWEST = 3
"""Windows; the interval of so few is wide, by Student's t."""
_MAJORITY, _TOGETHER, _WIDER = 5, 0.2, 1.5
"""Windows that make one, the range within which they agree over the deviation of all (a hand that
holds a torque reads as a sensor does, but not the same each time), and what their own deviation
counts, as they were picked for being close."""


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

    values, seconds = np.array([[reading.value, reading.seconds] for reading in found]).T
    wider = 1.0
    close = _closest(values)
    if len(close) >= _MAJORITY and np.ptp(values[close]) < _TOGETHER * np.std(values):
        values, seconds, wider = values[close], seconds[close], _WIDER
    middle = float(np.median(values))
    spread = wider * float(np.std(values, ddof=1))
    if abs(middle) > MOST_NM[signal] or spread > 0.2 * MOST_NM[signal]:
        return None
    half = float(t.ppf(0.975, len(values) - 1)) * spread / np.sqrt(len(values))
    mean = float(values.mean())
    return Offset(mean, (mean - half, mean + half), float(seconds.sum()))


def _closest(values: Floats) -> Integers:
    """Where the more than half of the values are that lie closest together (the shorth)."""
    order = np.argsort(values)
    count = len(values) // 2 + 1
    widths = values[order[count - 1 :]] - values[order[: len(values) - count + 1]]
    first = int(np.argmin(widths))
    return np.asarray(order[first : first + count])


def _windows(case: Case, signal: str, rotor_per_wheel: float) -> list[Reading]:
    if not case.recording.has(signal):
        return []
    noise = float(np.sqrt(case.recording.density[signal] / (2 * filters.STEP_S)))
    wheel = rotor_per_wheel if signal == "torque_sensor_nm" else None
    values, good = case.recording.raw[signal], case.recording.good
    return windows(values, case.motion.speed, good, noise, wheel)
