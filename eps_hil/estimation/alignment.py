"""Signals of any rate and delay, read off at one physical instant (DESIGN decision 2).

Every signal has a ring of stamped samples. A value at instant τ is read at stamp τ + delay by
linear interpolation between its neighbours, so a delay may be any fraction of a sample. All in
integer nanoseconds, so that a clock of seconds since 1970 loses nothing.
"""

import math

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.estimation.validity import Reason

RING = 512
"""Samples kept of each signal: half a second at 1 kHz."""
WRAP = RING - 1
"""``n & WRAP`` is ``n % RING``."""

_CLIP, _LEAST = 9.0, 0.01
"""So many variances count at most: a jump is no noise; of no less than this share of the settings'
figure: after a signal that stood still no noise would be seen any more."""
LATELY = 64
"""Samples that tell how large noise is now."""
_BAD, _GAP = int(Reason.BAD_SAMPLE), int(Reason.GAP)

Stamps = npt.NDArray[np.int64]
Values = npt.NDArray[np.float64]


@kernel
def push_sample(stamps: Stamps, values: Values, count: Stamps, i: int, t: int, v: float) -> bool:
    """Append to ring ``i``; False (and nothing stored) for a stamp that does not go forward."""
    n = count[i]
    if n > 0 and t <= stamps[i, (n - 1) & WRAP]:
        return False
    stamps[i, n & WRAP] = t
    values[i, n & WRAP] = v
    count[i] = n + 1
    return True


@kernel
def read_at(
    stamps: Stamps, values: Values, count: Stamps, i: int, t: int, stale: int, lost: int
) -> tuple[float, int]:
    """Value of ring ``i`` at stamp ``t``, and reason bits (``lost`` is the bit for 'not there').

    Beyond the newest sample the value is held until it is ``stale`` ns old; two neighbours
    further apart than ``stale`` are a gap.
    """
    value, why, _ = read_between(stamps, values, count, i, t, stale, lost)
    return value, why


@kernel
def read_between(
    stamps: Stamps,
    values: Values,
    count: Stamps,
    i: int,
    t: int,
    stale: int,
    lost: int,
    before: int = 1 << 62,
) -> tuple[float, int, int]:
    """As :func:`read_at`, and how far apart (ns) the neighbours are; beyond the newest sample, how
    far that is; 0 without any. Samples numbered ``before`` and higher are known to be of after
    ``t``."""
    n = count[i]
    if n == 0:
        return 0.0, lost, 0
    newest = stamps[i, (n - 1) & WRAP]
    if t >= newest:
        value = values[i, (n - 1) & WRAP]
        if t - newest > stale:
            return value, lost, t - newest
        return value, (0 if math.isfinite(value) else _BAD), t - newest
    oldest = max(0, n - RING)
    k = min(n - 2, before - 1)
    while k >= oldest and stamps[i, k & WRAP] > t:
        k -= 1
    if k < oldest:
        return values[i, oldest & WRAP], lost, 0
    t0, t1 = stamps[i, k & WRAP], stamps[i, (k + 1) & WRAP]
    v0, v1 = values[i, k & WRAP], values[i, (k + 1) & WRAP]
    value = v0 if t == t0 else v0 + (v1 - v0) * ((t - t0) / (t1 - t0))
    if not math.isfinite(value):
        return value, _BAD, t1 - t0
    return value, (_GAP if t1 - t0 > stale else 0), t1 - t0


@kernel
def learn_noise(
    stamps: Stamps, values: Values, n: int, i: int, known: Values, first: float, memory_ns: float
) -> None:
    """Follow the noise of ring ``i`` from the last four of its first ``n`` samples: ``known[i]``.

    ``known[i, 0]`` is its variance, ``known[i, 1]`` of how many samples it was learnt, ``first``
    the variance that the settings say. Third differences see noise and hardly any motion; of
    samples as they came, because interpolated ones have lost noise to their neighbours that is
    still there once it is averaged.
    """
    if n < 4:
        return
    bend, period = _bend(stamps, values, n, i)
    if not math.isfinite(bend):
        return
    share = period / memory_ns
    if share * (known[i, 1] + 1.0) < 1.0:
        known[i, 1] += 1.0
        share = 1.0 / known[i, 1]
    else:
        known[i, 1] = memory_ns / period
    power = min(0.05 * bend * bend, _CLIP * max(known[i, 0], _LEAST * first))
    known[i, 0] += share * (power - known[i, 0])


@kernel
def forget_noise(
    stamps: Stamps, values: Values, n: int, i: int, known: Values, below: float = 1.0
) -> None:
    """Believe the last samples of ring ``i`` where these have less noise than is ``known``: less
    than ``below`` of its variance.

    Where two transmitters sent by turns, their difference was learnt as noise. A value that stands
    still tells nothing: it may be one that is stuck.
    """
    total, found = 0.0, 0
    for k in range(max(n - LATELY, 4), n + 1):
        bend, _ = _bend(stamps, values, k, i)
        if math.isfinite(bend) and bend != 0.0:
            total, found = total + bend * bend / 20.0, found + 1
    if 2 * found > LATELY and total < below * known[i, 0] * found:
        known[i, 0], known[i, 1] = total / found, min(known[i, 1], float(found))


@kernel(inline="always")
def _bend(stamps: Stamps, values: Values, n: int, i: int) -> tuple[float, int]:
    """Third difference of ring ``i`` at its sample ``n`` and their period; NaN if uneven."""
    a, b, c, d = (n - 1) & WRAP, (n - 2) & WRAP, (n - 3) & WRAP, (n - 4) & WRAP
    period = stamps[i, a] - stamps[i, b]
    uneven = max(
        abs(stamps[i, b] - stamps[i, c] - period), abs(stamps[i, c] - stamps[i, d] - period)
    )
    if 4 * uneven > period:
        return math.nan, period
    return values[i, a] - values[i, d] + 3.0 * (values[i, c] - values[i, b]), period


@kernel
def slope(
    stamps: Stamps, values: Values, count: Stamps, i: int, window: int
) -> tuple[bool, int, float]:
    """Straight line through the last ``window`` ns of ring ``i``: (is there one, stamp, slope).

    The stamp is the mean of the samples' stamps, where a straight line's slope is that of any
    parabola: so the speed derived from an angle is late in arriving but not in what it says.
    """
    n = count[i]
    newest = stamps[i, (n - 1) & WRAP]
    k, total = n - 1, 0.0
    while k >= max(0, n - RING) and newest - stamps[i, k & WRAP] <= window:
        total += stamps[i, k & WRAP] - newest
        k -= 1
    points = n - 1 - k
    if points < 2:
        return False, 0, 0.0
    mean = total / points
    st, sv = 0.0, 0.0
    for j in range(k + 1, n):
        dt = stamps[i, j & WRAP] - newest - mean
        st += dt * dt
        sv += dt * values[i, j & WRAP]
    return True, newest + int(round(mean)), sv / st * 1e9
