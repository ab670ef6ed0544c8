"""A constant error of a torque sensor, from stretches in which the true torque is known to be zero.

In the torque balance an offset is the same thing as an asymmetry of the friction (eq. 3), so
sliding friction cannot show it. Hands off the wheel, or motor off, can: the reported torque then
does not care how the rotor moves, and what it reads is its offset.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.identification import filters
from eps_hil.identification.balance import Case

Floats = npt.NDArray[np.float64]

WINDOW_S = 2.0
MOST_NM = {"torque_sensor_nm": 0.5, "motor_torque_nm": 0.05}
"""A reading beyond this is a torque, not an offset."""
FEWEST = 5
_INERTIA_NM = 0.3


@dataclass(frozen=True)
class Offset:
    """What a signal reads (Nm) with no torque on it: value, 95 % interval, seconds looked at."""

    value: float
    ci95: tuple[float, float]
    seconds: float


def offset(cases: Sequence[Case], signal: str) -> Offset | None:
    """The offset of ``signal`` from windows in which nothing drives it; None without such."""
    found = [reading for case in cases for reading in _windows(case, signal)]
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


def _windows(case: Case, signal: str) -> list[float]:
    """Readings of the windows in which the rotor moves both ways and the signal stays quiet."""
    if not case.recording.has(signal):
        return []
    values = filters.smooth(case.recording.raw[signal])
    speed = filters.thinned(case.motion.speed)
    density = case.recording.density[signal]
    noise = np.sqrt(density * np.sum(filters.kernel() ** 2) / (2 * filters.STEP_S))
    n = round(WINDOW_S / (filters.STEP_S * filters.THIN))
    found = []
    for first in range(0, len(values) - n + 1, n):
        rows = slice(first, first + n)
        if not case.good[rows].all() or min(speed[rows].max(), -speed[rows].min()) < 2.0:
            continue
        # a free wheel still has its inertia and a little damping: neither has a mean of its own
        columns = np.column_stack([np.ones(n), speed[rows], case.motion.acceleration[rows]])
        coefficient = np.linalg.lstsq(columns, values[rows], rcond=None)[0]
        left = float(np.std(values[rows] - columns @ coefficient))
        driven = float(np.std(columns[:, 1:] @ coefficient[1:]))
        if left < 1.5 * noise + 1e-4 and driven < min(_INERTIA_NM, MOST_NM[signal]):
            found.append(float(coefficient[0]))
    return found
