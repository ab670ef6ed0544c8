"""What a torque sensor reads while nothing drives it: stretches with hands or motor off.

In the torque balance a sensor's constant error is the same thing as an asymmetry of the friction
(eq. 3), so sliding cannot show it. With the hands off the wheel the torsion bar carries no more
than the free wheel's inertia, damping and friction, T_sen = −J_w ψ̈ − d ψ̇ − T_w sign ψ̇; with the
motor off its torque is none at all. Neither has a mean of its own, whichever way the rotor moves.
"""

from functools import cache

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Masks = npt.NDArray[np.bool_]

WINDOW_S = 2.0
_STEP_S, _THIN = 1e-3, 8
_HALF = 150
"""Samples, half the length of the smoothing: −6 dB at 3.3 Hz, slower than a wheel swings."""
_MOVING_RAD_S, _TURNS_RAD_S = 2.0, 1.0
_NOISES, _LEAST_NM = 1.5, 1e-4
_SHARE = 0.05
"""Of what a free wheel makes the sensor read, what inertia and damping need not explain: a bar that
swings, a gain that turns with a joint. A hand leaves as much as it explains."""
_INERTIA_KG_M2 = (-0.01, 0.15)
"""Well beyond a steering wheel's: a hand that turns slowly against a spring looks heavier…"""
_LEAST_DAMPING_NM_S_PER_RAD = -0.05
"""…and one that drives feeds what a free wheel takes."""

_MOST_FRICTION_NM = 0.3
"""Of a wheel's bearings; a hand that pushes holds more, or helps."""


@cache
def _kernel() -> Floats:
    weight = np.hanning(2 * _HALF + 3)[1:-1]
    return np.asarray(weight / weight.sum())


def readings(
    values: Floats,
    speed: Floats,
    good: Masks,
    noise: float,
    rotor_per_wheel: float | None = None,
) -> list[float]:
    """Nm that a sensor reads in each window in which the rotor moves and nothing drives the sensor.

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
    found = []
    for first in range(0, len(slow) - n + 1, n):
        rows = slice(first, first + n)
        way = motion[0][rows]
        if not usable[rows].all() or min(way.max(), -way.min()) < _MOVING_RAD_S:
            continue
        level = _level(slow[rows], [one[rows] for one in motion], calm, rotor_per_wheel)
        if level is not None:
            found.append(level)
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
    size = np.sqrt(np.sum(columns**2, axis=0)) + 1e-300
    coefficient = np.linalg.lstsq(columns / size, values, rcond=None)[0] / size
    driven = columns[:, 1:] @ coefficient[1:]
    moved = float(np.std(driven))
    if float(np.std(values - columns @ coefficient)) > most + _SHARE * moved:
        return None
    if moved > 3.0 * most:
        damping, inertia = -coefficient[1:3] * rotor_per_wheel
        low, high = _INERTIA_KG_M2
        if not low < inertia < high or damping < _LEAST_DAMPING_NM_S_PER_RAD:
            return None
        if not -6.0 * most < -coefficient[-1] < _MOST_FRICTION_NM:
            return None
    return float(coefficient[0])
