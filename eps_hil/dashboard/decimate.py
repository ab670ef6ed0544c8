"""Samples reduced to what a screen shows: least and greatest of each pixel's stretch of time."""

import numpy as np
import numpy.typing as npt

Int64 = npt.NDArray[np.int64]
Float64 = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]

HOLD_NS = 100_000_000
"""A value stands for so long where no newer one comes; after that there is a gap."""


def least_and_greatest(
    t_ns: Int64, value: Float64, begin_ns: int, bucket_ns: int, n: int, hold_ns: int = HOLD_NS
) -> Float32:
    """Two points for each of ``n`` buckets from ``begin_ns`` on: shape (2n,), NaN for a gap.

    ``t_ns`` strictly increasing, ``value`` beside it. Rising or falling pairs, as the bucket's
    first and last samples do. Samples known to be bad (NaN) are left out where others are there;
    a bucket without samples holds the one before it for ``hold_ns``.
    """
    out = np.full((n, 2), np.nan, np.float32)
    if not len(t_ns) or n <= 0:
        return out.ravel()
    edges = begin_ns + bucket_ns * np.arange(n + 1, dtype=np.int64)
    place = np.searchsorted(t_ns, edges)
    first, last = place[:-1], place[1:]
    filled = last > first
    if filled.any():
        begin, end = first[filled], last[filled]
        cut = value[: end[-1]]  # whole buckets only: reduceat's last stretch ends with the data
        low, high = np.fmin.reduceat(cut, begin), np.fmax.reduceat(cut, begin)
        falls = cut[begin] > cut[end - 1]
        out[filled, 0] = np.where(falls, high, low)
        out[filled, 1] = np.where(falls, low, high)
    before = first[~filled] - 1
    age = edges[:-1][~filled] + bucket_ns // 2 - t_ns[np.maximum(before, 0)]
    held = np.where((before >= 0) & (age <= hold_ns), value[np.maximum(before, 0)], np.nan)
    out[~filled] = held[:, None]
    return out.ravel()


def at_instants(t_ns: Int64, value: Float64, at_ns: Int64, hold_ns: int = HOLD_NS) -> Float64:
    """Linear between neighbours, shape of ``at_ns``; NaN beside gaps longer than ``hold_ns``."""
    if len(t_ns) < 2:
        return np.full(len(at_ns), np.nan)
    right = np.clip(np.searchsorted(t_ns, at_ns), 1, len(t_ns) - 1)
    left = right - 1
    width = t_ns[right] - t_ns[left]
    share = (at_ns - t_ns[left]) / width
    between = value[left] + share * (value[right] - value[left])
    between = np.where(share == 1.0, value[right], between)  # the one on the left may be bad
    inside = (share >= 0.0) & (share <= 1.0) & (width <= hold_ns)
    return np.where(inside, between, np.nan)
