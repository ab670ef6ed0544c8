"""The Butterworth low-pass without phase, of identification and diagnosis alike, at 1 kHz.

Written out here for a diagnosis that is waited for: scipy's own has to be imported with all of
``scipy.signal`` and ``scipy.stats``, and works its starting state out anew for every call.
``tests/identification/test_butterworth.py`` holds both to one another.
"""

from functools import cache

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit

Floats = npt.NDArray[np.float64]

RATE_HZ = 1000.0
_GRID = 4096


def low_pass(values: Floats, corner_hz: float, order: int = 4) -> Floats:
    """Forward and backward, (n,) -> (n,); as ``scipy.signal.sosfiltfilt``.

    ``order`` is 1, 2 or 4 (of one way). ``ValueError``: fewer samples than the filter needs.
    """
    edge = 3 * (order + 1)
    if len(values) <= edge:
        raise ValueError("is too short for its filters")
    before, after = 2 * values[0] - values[edge:0:-1], 2 * values[-1] - values[-2 : -edge - 2 : -1]
    there = np.concatenate([before, values, after])
    _there_and_back(there, *_sections(corner_hz, order))
    return there[edge:-edge]


@cache
def passed(corner_hz: float, power: int, order: int = 4) -> float:
    """What :func:`low_pass` leaves of white noise's variance, times (2πf) to this power."""
    frequency_hz, gain = power_gain(corner_hz, order)
    return float(np.mean(gain * (2.0 * np.pi * frequency_hz) ** power))


@cache
def power_gain(corner_hz: float, order: int = 4) -> tuple[Floats, Floats]:
    """Frequencies up to half the sampling rate (Hz), and the gain of :func:`low_pass` for power."""
    share = np.arange(_GRID) / _GRID
    warped = np.tan(0.5 * np.pi * share) / _warped(corner_hz)
    gain = (1.0 / (1.0 + warped ** (2 * order))) ** 2  # forward and backward
    return 0.5 * RATE_HZ * share, gain


def _warped(corner_hz: float) -> float:
    """The corner on the bilinear transform's axis."""
    return float(np.tan(np.pi * corner_hz / RATE_HZ))


@cache
def _sections(corner_hz: float, order: int) -> tuple[Floats, Floats]:
    """Coefficients b0, b1, b2, a1, a2 of two sections and their states after a constant of one.

    A filter of the first or second order is its own first section, the other passes all.
    """
    sections = np.zeros((2, 5))
    sections[:, 0] = 1.0
    corner = _warped(corner_hz)
    if order == 1:
        b = corner / (1.0 + corner)
        sections[0] = b, b, 0.0, (corner - 1.0) / (corner + 1.0), 0.0
    else:
        for k in range(order // 2):
            damping = 2.0 * np.sin(np.pi * (2 * k + 1) / (2 * order)) * corner  # of a pair of poles
            whole = 1.0 + damping + corner**2
            b = corner**2 / whole
            a1, a2 = 2.0 * (corner**2 - 1.0) / whole, (1.0 - damping + corner**2) / whole
            sections[k] = b, 2.0 * b, b, a1, a2
    settled = np.column_stack([1.0 - sections[:, 0], sections[:, 2] - sections[:, 4]])
    return sections, settled


@njit
def _there_and_back(values: Floats, sections: Floats, settled: Floats) -> None:
    """Through both sections, forward and backward, in place."""
    _through(values, sections, settled * values[0])
    _through(values[::-1], sections, settled * values[-1])


@njit(inline="always")
def _through(values: Floats, sections: Floats, state: Floats) -> None:
    """Through both sections (transposed direct form II); scalars stay in registers."""
    s = sections
    b0, b1, b2, a1, a2 = s[0, 0], s[0, 1], s[0, 2], s[0, 3], s[0, 4]
    c0, c1, c2, d1, d2 = s[1, 0], s[1, 1], s[1, 2], s[1, 3], s[1, 4]
    y0, y1, z0, z1 = state[0, 0], state[0, 1], state[1, 0], state[1, 1]
    for k in range(len(values)):
        given = values[k]
        between = b0 * given + y0
        y0 = b1 * given - a1 * between + y1
        y1 = b2 * given - a2 * between
        out = c0 * between + z0
        z0 = c1 * between - d1 * out + z1
        z1 = c2 * between - d2 * out
        values[k] = out
