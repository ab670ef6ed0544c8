"""A slow signal in a fast table, its rows filled with the value before: back to its own samples.

As it stands, its noise comes in steps and shows in no difference of neighbours, its repeats look
like clipping, and it is late by half its period on average, which would become physics.
"""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from eps_hil.series import Series

Signals = Mapping[str, Series]
Integers = npt.NDArray[np.int64]

LEAST_STEPS = 3
"""Rows a value has to last at least: every other row may be chance in a coarse signal."""
LEAST_CHANGES = 20
"""So many changes of value, all a multiple of the same step apart, are no chance."""


def own_samples(recordings: Mapping[str, Signals]) -> dict[str, Signals]:
    """Recordings with every signal at its own rate."""
    return {
        recording: {name: own_sampled(one) for name, one in series.items()}
        for recording, series in recordings.items()
    }


def own_sampled(one: Series) -> Series:
    """The signal without repeats, where it changes every k-th row (k ≥ 3) only; else as it was.

    A value that happens to be the same at the next of these rows is a sample like the others.
    """
    if len(one.t_ns) <= LEAST_STEPS * LEAST_CHANGES:
        return one
    row = _rows(one.t_ns)
    change = _changes(row, one.value)
    if len(change) < LEAST_CHANGES:
        return one
    step = int(np.gcd.reduce(np.diff(change)))
    if step < LEAST_STEPS:
        return one
    own = (row - change[0]) % step == 0
    return Series(one.t_ns[own], one.value[own])


def _rows(t_ns: Integers) -> Integers:
    """Places (n,) on the grid of the usual step, so that a lost row does not move those after."""
    steps = np.diff(t_ns)
    whole = np.rint(steps / np.median(steps)).astype(np.int64)
    return np.concatenate([[0], np.cumsum(whole)])


def _changes(row: Integers, value: npt.NDArray[np.float64]) -> Integers:
    """Rows with another value than the row just before; what changed in a hole is not known."""
    before, after = value[:-1], value[1:]
    seen = np.isfinite(before) & np.isfinite(after) & (np.diff(row) == 1)
    return np.asarray(row[1:][seen & (before != after)])
