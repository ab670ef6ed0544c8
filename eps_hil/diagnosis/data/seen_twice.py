"""Up to which frequency a slow speed's changes are motion: the angle is a second witness of them.

A speed that is sampled slowly, unevenly or of a coarse encoder has noise while it moves that none
of its samples at rest shows, and a derivative raises it above all else. What both signals have in
common, as a row that comes late, counts as motion.
"""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_SEGMENT_S, _SLOW_HZ = 4.0, 1.0
_ORDER = 4
"""Of the low-pass, one way."""
_SURE = 3.0
"""Standard errors by which less has to be more."""
_WINDOW = 1.5
"""Frequencies of a Hann window's resolution."""


def motion_hz(speed: Floats, rate: Floats, step_s: float, most_hz: float) -> float:
    """Corner of a low-pass of ``speed`` (n,), for the least error of its derivative in a balance.

    Taking off x for an acceleration a takes 2 E x a − E x² off the mean square; ``rate`` (n,), the
    angle's, stands for what of x is motion. ``inf`` where none is surely better.
    """
    count = round(_SEGMENT_S / step_s)
    if len(speed) < 2 * count or most_hz <= _SLOW_HZ:
        return np.inf
    one, other = (_spectra(signal, count) for signal in (speed, rate))
    at = np.fft.rfftfreq(count, step_s)
    some = (at > 0.0) & (at <= most_hz)
    one, other, at = one[:, some], other[:, some], at[some]
    own, witness = (np.mean(np.abs(x) ** 2, axis=0) for x in (one, other))
    both = np.mean((one * np.conj(other)).real, axis=0)
    slow = at <= _SLOW_HZ
    scale = float(np.sum(both[slow])) / max(float(np.sum(own[slow])), 1e-300)
    if scale <= 0.0:
        return np.inf
    corners = at[at >= _SLOW_HZ, None]
    passes = 1.0 / (1.0 + (at / corners) ** (2 * _ORDER))  # there and back
    more = (2.0 * (passes - 1.0) * both / scale - (passes**2 - 1.0) * own) @ at**2
    best = int(np.argmax(more))
    independent = 0.5 * (len(one) + 1) / _WINDOW
    unsure = (at**2 * 2.0 * (1.0 - passes[best]) / scale) ** 2 * own * witness
    error = np.sqrt(float(np.sum(unsure)) / (2.0 * independent))
    return float(corners[best, 0]) if more[best] > _SURE * error else np.inf


def _spectra(signal: Floats, count: int) -> npt.NDArray[np.complex128]:
    """Of half overlapping segments without their mean, (segments, frequencies)."""
    parts = np.lib.stride_tricks.sliding_window_view(signal, count)[:: count // 2]
    parts = parts - np.mean(parts, axis=1, keepdims=True)
    return np.asarray(np.fft.rfft(parts * np.hanning(count), axis=1))
