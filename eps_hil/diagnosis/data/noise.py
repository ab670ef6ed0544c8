"""The noise of a signal by its own samples: white, on smooth motion, coarse or fine.

What differences tell is the noise of the highest frequencies. A speed that is counted from the
steps of an encoder has far less below, where it is judged: its noise grows with frequency. Taken
for white it would make an inertia too large, of which errors in variables say that J σ is as large.
But noise that does not fall with frequency is nowhere more than all that a signal holds from there
on: so far it is bounded by the signal's spectrum.
"""

from itertools import pairwise
from math import comb

import numpy as np
import numpy.typing as npt

from eps_hil.identification.butterworth import passed
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

_STEP_S = 1e-3
_TAIL = 10.0
_UNEVEN, _AT_ONCE, _FEWEST = 0.05, 0.2, 100
"""Of a sampling interval: deviation of intervals from which samples are not even; share of the
longest that the shortest beside it has to be; differences that say anything."""
_WINDOW, _FEWEST_WINDOWS, _QUARTER, _QUIETER = 12, 40, 0.504, 0.7
"""Samples of a window that may be quiet, how many windows tell, the lower quartile of white noise's
mean square there, and below which share of the noise of all samples theirs is believed."""
_OCTAVES_HZ, _JUDGED_HZ, _ORDER = (5.0, 10.0, 20.0, 40.0, 80.0), 40.0, 4
"""Bands in which there is no more noise than signal; the low-pass of what is judged."""
_SEGMENT_S, _SURE = 2.0, 3.0
"""Of spectra; standard errors by which a band has to hold less."""
_OFF, _LATTICE = 0.1, 0.9
"""Of the smallest step: how far a change may be from a multiple; share of changes that are one."""


def noise_at_1_khz(one: Series, *, moving: bool, derivatives: int = 0) -> float:
    """The white noise on the 1 kHz grid that is as strong below the cut-off as the signal's own.

    In that derivative of it that a balance needs, where the spectrum shows that it is not white.

    Of a signal at another rate: its noise is spread over another band. Of a ``moving`` one it is
    what there is while it moves least: samples that lie far apart make noise of quick motion, but
    an encoder's noise is the same at any speed.
    """
    good = np.isfinite(one.value)
    steps = np.diff(one.t_ns[good]) * 1e-9
    step = float(np.median(steps))
    uneven = float(np.std(steps)) > _UNEVEN * step
    stamps = np.asarray(one.t_ns[good] * 1e-9, dtype=np.float64)
    found = noise_of(one.value[good], stamps if uneven else None)
    if not uneven:
        found = _bounded(found, one.value[good], step, 2 * derivatives)
    if moving and step > 1.5 * _STEP_S:
        quiet = quiet_noise_of(one.value[good])
        found = quiet if quiet < _QUIETER * found else found
    return found * float(np.sqrt(step / _STEP_S))


def noise_of(values: Floats, time_s: Floats | None = None) -> float:
    """Standard deviation of white noise on a smooth signal, from its higher differences.

    From third and sixth differences, and the smaller: noise is the same in both, motion that is
    fast beside the samples is not. Heavy tails count, as the filter adds them up; beyond ten usual
    sizes it is motion (a step, a burst) and counts no more. 0 for a constant.
    With ``time_s`` also from divided differences: values may be even by number or by their stamps.
    """
    third = np.diff(values, n=3)
    found = [_noise_of(np.abs(third), 3), _noise_of(np.abs(np.diff(third, n=3)), 6)]
    if time_s is not None:
        divided = ((n, _divided(values, time_s, n)) for n in (3, 6))
        found += [_noise_of(np.abs(one), n) for n, one in divided if len(one) > _FEWEST]
    return min(found)


def _bounded(white: float, values: Floats, step_s: float, power: int) -> float:
    """White noise that is as strong, times (2πf) to this power, as what no octave rules out."""
    count = round(_SEGMENT_S / step_s)
    if 2.0 * step_s * _OCTAVES_HZ[-1] > 1.0 or len(values) < 2 * count or white == 0.0:
        return white
    at = np.fft.rfftfreq(count, step_s)
    held = np.mean(np.abs(segments(values, count)) ** 2, axis=0) / np.sum(np.hanning(count) ** 2)
    most = np.full(len(at), white**2)
    for low, high in reversed(list(pairwise(_OCTAVES_HZ))):
        unsure = 1.0 / np.sqrt((high - low) * len(values) * step_s)
        level = float(np.mean(held[(at >= low) & (at < high)])) * (1.0 + _SURE * unsure)
        most[at < high] = np.minimum(most[at < high], level)
    passes = 1.0 / (1.0 + (at / _JUDGED_HZ) ** (2 * _ORDER)) ** 2 * at**power
    return float(np.sqrt(passes @ most / np.sum(passes)))


def segments(values: Floats, count: int) -> npt.NDArray[np.complex128]:
    """Spectra of half overlapping segments without their mean, (segments, frequencies)."""
    parts = np.lib.stride_tricks.sliding_window_view(values, count)[:: count // 2]
    parts = parts - np.mean(parts, axis=1, keepdims=True)
    return np.asarray(np.fft.rfft(parts * np.hanning(count), axis=1))


def quiet_noise_of(values: Floats) -> float:
    """The same in the quietest quarter of short windows; no less than steps of a coarse signal.

    Of noise that is the same everywhere the quarter's window holds less than the mean, by chance
    (chi-square): that is put back. ``inf`` for less than some windows.
    """
    windows = len(values) // _WINDOW
    if windows < _FEWEST_WINDOWS:
        return np.inf
    third = np.diff(values[: windows * _WINDOW].reshape(windows, _WINDOW), n=3, axis=1)
    quarter = float(np.quantile(np.mean(third**2, axis=1), 0.25)) / (20.0 * _QUARTER)
    steps = np.abs(np.diff(values))
    step = float(np.min(steps[steps > 0.0], initial=np.inf))
    whole = steps / step
    coarse = np.isfinite(step) and float(np.mean(np.abs(whole - np.rint(whole)) < _OFF)) > _LATTICE
    return float(np.sqrt(max(quarter, step**2 / 12.0 if coarse else 0.0)))


def _divided(values: Floats, time_s: Floats, order: int) -> Floats:
    """Divided differences, each as large by white noise as a difference of even samples is.

    Not of samples that came nearly at once, whose values are often one and the same.
    """
    at = np.lib.stride_tricks.sliding_window_view(time_s, order + 1)
    apart = at[:, :, None] - at[:, None, :]
    apart[:, np.arange(order + 1), np.arange(order + 1)] = 1.0
    weight = 1.0 / np.prod(apart / np.mean(np.diff(time_s)), axis=2)
    weight *= np.sqrt(comb(2 * order, order) / np.sum(weight**2, axis=1))[:, None]
    shown = np.lib.stride_tricks.sliding_window_view(values, order + 1)
    steps = np.diff(at, axis=1)
    even = np.min(steps, axis=1) > _AT_ONCE * np.max(steps, axis=1)
    return np.asarray(np.sum(weight * (shown - shown[:, :1]), axis=1))[even]


def _noise_of(bends: Floats, order: int) -> float:
    """From the sizes of one order of difference."""
    scale = float(comb(2 * order, order))
    if np.count_nonzero(bends) < 0.2 * len(bends):
        return float(np.sqrt(np.mean(bends**2) / scale))
    usual = float(np.median(bends)) / 0.6745
    if usual == 0.0:  # of a value that is held for some rows, now more, now fewer
        usual = float(np.median(bends[bends > 0.0])) / 0.6745
    return float(np.sqrt(np.mean(np.minimum(bends, _TAIL * usual) ** 2) / scale))


def half_rate_hz(one: Series) -> float:
    """Half its rate; no limit for what is at least as fast as the grid."""
    step_s = float(np.median(np.diff(one.t_ns))) * 1e-9
    return 0.5 / step_s if step_s > 1.5 * _STEP_S else np.inf


def passed_of_band(band_hz: float, corner_hz: float, power: int) -> float:
    """What the low-pass leaves of noise that is white up to a band's end, as ``passed``."""
    if band_hz > 2.0 * corner_hz:
        return passed(corner_hz, power)
    whole = 2.0 * band_hz * _STEP_S * (2.0 * np.pi * band_hz) ** power / (power + 1)
    return min(passed(corner_hz, power), float(whole))
