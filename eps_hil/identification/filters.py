"""The one filter of an identification: a raised cosine, which has an end.

A finite response means that a sample which must not count (a gap, a reversal) reaches no further
than half its length. Applied to every term after its nonlinearity, then thinned.
"""

from functools import cache

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

STEP_S = 1e-3
HALF = 20
"""Half the length in samples: 40 ms in all, −6 dB at 25 Hz."""
THIN = 5
"""Every THIN-th filtered sample is kept (200 Hz)."""
_HOLE = 3.5
"""Steps of a signal without a value that are a hole: two lost frames in a row are none."""


@cache
def kernel() -> Floats:
    """The smoothing weights, (2 HALF + 1,)."""
    turn = np.pi * np.arange(-HALF, HALF + 1) / (HALF + 1)
    weight = 1.0 + np.cos(turn)
    return np.asarray(weight / weight.sum())


def shifted(values: Floats, seconds: float) -> Floats:
    """``values`` read off ``seconds`` later, by cubics through four samples; (n,), ends held."""
    whole = int(np.floor(seconds / STEP_S))
    a = seconds / STEP_S - whole
    if whole == 0 and a == 0.0:
        return values
    weights = (
        -a * (a - 1) * (a - 2) / 6,
        (a + 1) * (a - 1) * (a - 2) / 2,
        -(a + 1) * a * (a - 2) / 2,
        (a + 1) * a * (a - 1) / 6,
    )
    out = np.empty(len(values))
    _read_off(values, whole, *weights, out)
    return out


@njit
def _read_off(
    values: Floats, whole: int, w0: float, w1: float, w2: float, w3: float, out: Floats
) -> None:
    """Four samples from ``whole`` − 1 on under their weights; the first and last value held."""
    n = len(values)
    first, last = max(0, 1 - whole), min(n, n - whole - 2)
    if first < last:
        at = first + whole
        a, b, c, d = values[at - 1 :], values[at:], values[at + 1 :], values[at + 2 :]
        inside = out[first:last]
        for k in range(len(inside)):  # plain enough to take several samples at once
            inside[k] = w0 * a[k] + w1 * b[k] + w2 * c[k] + w3 * d[k]
    for begin, end in ((0, min(first, n)), (max(first, last), n)):
        for k in range(begin, end):
            at = k + whole
            out[k] = (
                w0 * values[min(max(at - 1, 0), n - 1)]
                + w1 * values[min(max(at, 0), n - 1)]
                + w2 * values[min(max(at + 1, 0), n - 1)]
                + w3 * values[min(max(at + 2, 0), n - 1)]
            )


def between(t_ns: npt.NDArray[np.int64], values: Floats, grid_ns: npt.NDArray[np.int64]) -> Floats:
    """A sampled signal read at other instants (ns, ascending); ends held, straight through holes.

    Slower than 1 kHz by a cubic spline: straight lines take noise off between the samples, and off
    fast motion too (7 % of 30 Hz at 200 values a second, sinc²). Stamps in bunches are no signal
    that a spline may be laid through.
    """
    steps = np.diff(t_ns)
    usual = float(np.median(steps)) if len(steps) else 0.0
    straight = np.asarray(np.interp(grid_ns, t_ns, values), dtype=np.float64)
    if usual <= 1.5e9 * STEP_S or len(values) < 4 or steps.min() <= 0.2 * usual:
        return straight
    from scipy.interpolate import CubicSpline

    inside = np.clip(grid_ns, t_ns[0], t_ns[-1])
    bent = np.asarray(CubicSpline(t_ns * 1e-9, values)(inside * 1e-9), dtype=np.float64)
    step = np.clip(np.searchsorted(t_ns, inside, side="right") - 1, 0, len(steps) - 1)
    return np.where(steps[step] > _HOLE * usual, straight, bent)


def on_grid(one: Series, origin: int, t_ns: npt.NDArray[np.int64]) -> Floats:
    """A signal at ``t_ns`` (1 kHz, ns) since ``origin``, its samples without a value left out."""
    good = np.isfinite(one.value)
    if not good.all():
        one = Series(one.t_ns[good], one.value[good])
    at, value = one.t_ns - origin, one.value
    first = int(np.searchsorted(at, 0))
    if np.array_equal(at[first : first + len(t_ns)], t_ns):
        return value[first : first + len(t_ns)]  # on the grid as it is
    if float(np.median(np.diff(at))) > 0.9e9 * STEP_S:
        return between(at, value, t_ns)
    # faster than the grid: the mean over a step, so that noise above it does not fold down
    area = np.concatenate([[0.0], np.cumsum(0.5 * (value[1:] + value[:-1]) * np.diff(at))])
    half = round(0.5e9 * STEP_S)
    low, high = np.clip(t_ns - half, at[0], at[-1]), np.clip(t_ns + half, at[0], at[-1])
    return np.asarray((np.interp(high, at, area) - np.interp(low, at, area)) / (high - low))


def every_so_many(values: Floats, every: int, first: int, *, summed: bool) -> Floats:
    """Every so many samples (n,) from the ``first`` on, or what their steps add up to."""
    if every == 1:
        return values
    if summed:
        way = np.cumsum(values)[first::every]
        return np.diff(way, prepend=way[0] - values[first])
    return np.ascontiguousarray(values[first::every])


def slope(values: Floats) -> Floats:
    """Unfiltered derivative, 1/s, (n,); exact for polynomials of the fourth degree."""
    held = np.pad(values, 2, mode="reflect", reflect_type="odd")
    bent = held[:-4] - 8 * held[1:-3] + 8 * held[3:-1] - held[4:]
    return np.asarray(bent / (12 * STEP_S))


def smooth(values: Floats) -> Floats:
    """Filtered, thinned: (n,) -> (m,), the ends left out where the filter has only one side."""
    return np.asarray(smooth_rows(np.ascontiguousarray(values)[None, :])[0])


def derivative(values: Floats) -> Floats:
    """Filtered derivative in 1/s, thinned."""
    return smooth(slope(values))


def thinned(values: Floats) -> Floats:
    """The unfiltered values at the samples that are kept."""
    return values[HALF : len(values) - HALF : THIN]


def low_pass_power(frequency_hz: Floats, corner_hz: float, order: int = 4) -> Floats:
    """Gain of ``butterworth.low_pass`` for power, well below half the sampling rate."""
    return np.asarray(1.0 / (1.0 + (frequency_hz / corner_hz) ** (2 * order)) ** 2)


def derivative_variance(density_hz: Floats, frequency_hz: Floats) -> float:
    """Variance of filtered, differentiated noise of a one-sided density over frequency."""
    t = np.arange(-HALF, HALF + 1) * STEP_S
    response = np.abs(np.exp(-2j * np.pi * np.outer(frequency_hz, t)) @ kernel())
    turn = 2 * np.pi * frequency_hz * STEP_S
    response *= np.abs(8 * np.sin(turn) - np.sin(2 * turn)) / (6 * STEP_S)
    return float(np.sum(response**2 * density_hz) * (frequency_hz[1] - frequency_hz[0]))


def smooth_rows(values: Floats) -> Floats:
    """As :func:`smooth` for several signals at once: (k, n) -> (k, m)."""
    out = np.empty((len(values), max(0, (values.shape[1] - 2 * HALF - 1) // THIN + 1)))
    _weighed(values, kernel(), THIN, out)
    return out


@njit
def _weighed(values: Floats, kernel: Floats, every: int, out: Floats) -> None:
    for row in range(len(out)):
        for k in range(out.shape[1]):
            total = 0.0
            for j in range(len(kernel)):
                total += kernel[j] * values[row, k * every + j]
            out[row, k] = total
