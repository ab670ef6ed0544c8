"""Up to which frequency a slow speed's changes are motion: the angle is a second witness of them.

A speed that is sampled slowly, unevenly or of a coarse encoder has noise while it moves that none
of its samples at rest shows, and a derivative raises it above all else. What both signals have in
common, as a row that comes late, counts as motion. All recordings of a machine share one corner:
noise is that of its sensors, and with a corner each they would count by how they happen to move.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.data.noise import segments

Floats = npt.NDArray[np.float64]

_SEGMENT_S, _SLOW_HZ = 4.0, 1.0
_ORDER = 4
"""Of the low-pass, one way."""
_SURE = 3.0
"""Standard errors by which less has to be more."""
_WINDOW = 1.5
"""Frequencies of a Hann window's resolution."""


def motion_hz(pairs: Sequence[tuple[Floats, Floats]], step_s: float, most_hz: float) -> float:
    """Corner of a low-pass of speeds, for the least error of their derivative in a balance.

    ``pairs``: of each recording of a machine its speed (n,) and its angle's rate (n,). Taking off
    x for an acceleration a takes 2 E x a − E x² off the mean square; the rate stands for what of x
    is motion. ``inf`` where no corner is surely better.
    """
    count = round(_SEGMENT_S / step_s)
    seen = [_spectra(*pair, count) for pair in pairs if len(pair[0]) >= 2 * count]
    if not seen or most_hz <= _SLOW_HZ:
        return np.inf
    at = np.fft.rfftfreq(count, step_s)
    some = (at > 0.0) & (at <= most_hz)
    at = at[some]
    own, both = (np.sum([one[k][some] for one in seen], axis=0) for k in (0, 1))
    slow = at <= _SLOW_HZ
    scale = float(np.sum(both[slow])) / max(float(np.sum(own[slow])), 1e-300)
    if scale <= 0.0:
        return np.inf
    corners = at[at >= _SLOW_HZ, None]
    passes = 1.0 / (1.0 + (at / corners) ** (2 * _ORDER))  # there and back
    more = (2.0 * (passes - 1.0) * both / scale - (passes**2 - 1.0) * own) @ at**2
    best = int(np.argmax(more))
    of_witness = (at**2 * 2.0 * (1.0 - passes[best]) / scale) ** 2
    unsure = sum(float(np.sum(of_witness * one[2][some])) for one in seen)
    return float(corners[best, 0]) if more[best] > _SURE * np.sqrt(unsure) else np.inf


def _spectra(speed: Floats, rate: Floats, count: int) -> tuple[Floats, Floats, Floats]:
    """|speed|², the real part of speed times rate, and the variance of that by noise of the rate
    (frequencies,): sums over half overlapping segments without their mean.
    """
    one, other = (segments(signal, count) for signal in (speed, rate))
    own, witness = (np.sum(np.abs(x) ** 2, axis=0) for x in (one, other))
    both = np.sum((one * np.conj(other)).real, axis=0)
    independent = 0.5 * (len(one) + 1) / _WINDOW
    return own, both, own * witness / (2.0 * independent)
