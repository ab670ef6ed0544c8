"""What a torque sensor reads while nothing drives it: stretches with hands or motor off.

In the torque balance a sensor's constant error is the same thing as an asymmetry of the friction
(eq. 3), so sliding cannot show it. With the hands off the wheel the torsion bar carries no more
than the free wheel's inertia, damping and friction, T_sen = −J_w ψ̈ − d ψ̇ − T_w sign ψ̇; with the
motor off its torque is none at all. Neither has a mean of its own, whichever way the rotor moves.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Masks = npt.NDArray[np.bool_]

WINDOW_S = 2.0
_LONGER = (1, 2, 3, 4)
"""Windows taken as one until the rotor has moved both ways in it: a slow turn takes seconds."""
_STEP_S, _THIN = 1e-3, 8
_HALF = 150
"""Samples, half the length of the smoothing: −6 dB at 3.3 Hz, slower than a wheel swings."""
_MOVING_RAD_S, _TURNS_RAD_S = 2.0, 1.0
_NOISES, _LEAST_NM = 1.5, 1e-4
_SHARE = 0.05
"""Of what a free wheel makes the sensor read, what inertia and damping need not explain: a bar that
swings, a gain that turns with a joint. A hand leaves as much as it explains."""
_MORE = 0.2
"""Of it, what a bar that swings may add to inertia, damping and friction."""
_INERTIA_KG_M2 = (-0.01, 0.15)
"""Well beyond a steering wheel's: a hand that turns slowly against a spring looks heavier…"""
_LEAST_DAMPING_NM_S_PER_RAD = -0.05
"""…and one that drives feeds what a free wheel takes."""

_PLAIN = [0, 1, 2, 5]
"""Columns of a window's fit: constant, speed, acceleration, friction; two more derivatives are what
a bar that swings adds."""
_MOST_FRICTION_NM = 0.3
"""Of a wheel's bearings; a hand that pushes holds more, or helps."""


@cache
def _kernel() -> Floats:
    weight = np.hanning(2 * _HALF + 3)[1:-1]
    return np.asarray(weight / weight.sum())


@dataclass(frozen=True, slots=True)
class Reading:
    """Nm that a sensor reads with nothing on it, in a window of so many seconds."""

    value: float
    seconds: float


def readings(
    values: Floats,
    speed: Floats,
    good: Masks,
    noise: float,
    rotor_per_wheel: float | None = None,
) -> list[float]:
    """The values of :func:`windows`, Nm."""
    found = windows(values, speed, good, noise, rotor_per_wheel)
    return [one.value for one in found]


def windows(
    values: Floats,
    speed: Floats,
    good: Masks,
    noise: float,
    rotor_per_wheel: float | None = None,
) -> list[Reading]:
    """What a sensor reads in each window in which the rotor moves both ways and nothing drives it.

    A window is 2 s long, or up to 8 s where the rotor turns more slowly.

    ``values`` (n,) Nm and rotor ``speed`` (n,) rad/s at 1 kHz; ``good`` (n,): what may be used;
    ``noise``: rms of the values' white noise. ``rotor_per_wheel`` (rad/rad) where a free wheel
    hangs on the sensor; None for the motor, which carries nothing when it is off. Nothing of a
    signal without noise: a constant in a file is no reading.
    """
    if noise <= 0.0 or len(values) < 2 * _HALF + 1:
        return []
    slow = _smooth(values)
    motion = [_smooth(speed)]
    bad = np.concatenate([[0], np.cumsum(~good)])
    usable = (bad[2 * _HALF + 1 :] == bad[: -2 * _HALF - 1])[::_THIN]
    for _ in range(3):
        motion.append(np.gradient(motion[-1], _STEP_S * _THIN))
    motion.append(_smooth(np.tanh(speed / _TURNS_RAD_S)))  # the friction of a wheel's bearings
    calm = noise * float(np.sqrt(np.sum(_kernel() ** 2)))
    n = round(WINDOW_S / (_STEP_S * _THIN))
    found, first = [], 0
    while first + n <= len(slow):
        count, level = 1, None
        for longer in _LONGER:
            rows = slice(first, first + longer * n)
            way = motion[0][rows]
            if len(way) < longer * n or not usable[rows].all():
                break
            if min(way.max(), -way.min()) >= _MOVING_RAD_S:
                level = _level(slow[rows], [one[rows] for one in motion], calm, rotor_per_wheel)
                count = longer if level is not None else 1
                break
        if level is not None:
            found.append(Reading(level, count * WINDOW_S))
        first += count * n
    return found


def _smooth(values: Floats) -> Floats:
    """Under the kernel, at the samples that are kept alone."""
    weight = _kernel()
    windows = np.lib.stride_tricks.sliding_window_view(values, len(weight))[::_THIN]
    return np.asarray(windows @ weight)


def _level(
    values: Floats, motion: list[Floats], calm: float, rotor_per_wheel: float | None
) -> float | None:
    """The constant in a window's ``values``, if they hold that and a free wheel at most."""
    most = _NOISES * calm + _LEAST_NM
    if rotor_per_wheel is None:
        return float(np.mean(values)) if float(np.std(values)) < most else None
    columns = np.column_stack([np.ones(len(values)), *motion])
    coefficient = _solved(columns, values)
    driven = columns[:, 1:] @ coefficient[1:]
    moved = float(np.std(driven))
    if float(np.std(values - columns @ coefficient)) > most + _SHARE * moved:
        return None
    if moved > 3.0 * most:
        # of a motion like a sine's, higher derivatives are its speed and acceleration over again
        plain = _solved(columns[:, _PLAIN], values)
        if float(np.std(values - columns[:, _PLAIN] @ plain)) > most + _MORE * moved:
            return None
        damping, inertia = -plain[1:3] * rotor_per_wheel
        low, high = _INERTIA_KG_M2
        if not low < inertia < high or damping < _LEAST_DAMPING_NM_S_PER_RAD:
            return None
        if not -6.0 * most < -plain[-1] < _MOST_FRICTION_NM:
            return None
    return float(coefficient[0])


def _solved(columns: Floats, values: Floats) -> Floats:
    size = np.sqrt(np.sum(columns**2, axis=0)) + 1e-300
    return np.asarray(np.linalg.lstsq(columns / size, values, rcond=1e-6)[0] / size)
