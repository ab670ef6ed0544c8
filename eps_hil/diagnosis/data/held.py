"""A slow signal in a fast table, its rows filled with the value before: back to its own samples.

As it stands, its noise comes in steps and shows in no difference of neighbours, its repeats look
like clipping, and it is late by half its period on average, which would become physics.
"""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.series import Series

Signals = Mapping[str, Series]
Integers = npt.NDArray[np.int64]

LEAST_STEPS = 3
"""Rows a value has to last at least: every other row may be chance in a coarse signal."""
LEAST_CHANGES = 20
"""So many changes of value, all a multiple of the same step apart, are no chance."""
_STEP_BY_STEP = 0.5
_JITTER, _MOST_BEATS, _REGULAR = 0.45, 2.0, 0.95
"""Of a beat: how far a change may be from it; beats that one value may last; share of changes that
keep to both."""


def own_samples(recordings: Mapping[str, Signals]) -> dict[str, Signals]:
    """Recordings with every signal at its own rate."""

    def own(series: Signals) -> Signals:
        return {name: own_sampled(one) for name, one in series.items()}

    return dict(zip(recordings, each(own, recordings.values()), strict=True))


def own_sampled(one: Series) -> Series:
    """The signal without repeats, where it changes every k-th row (k ≥ 3) only; else as it was.

    A value that happens to be the same at the next of these rows is a sample like the others. So
    is a signal read with jitter, about every k-th row: its samples are its changes, and between
    them about every k-th row.
    """
    if len(one.t_ns) <= LEAST_STEPS * LEAST_CHANGES:
        return one
    row = _rows(one.t_ns)
    change = _changes(row, one.value)
    if len(change) < LEAST_CHANGES:
        return one
    step = int(np.gcd.reduce(np.diff(change)))
    if step >= LEAST_STEPS:
        own = (row - change[0]) % step == 0
    elif _beats(np.diff(change)) and _jumps(row, change, one.value):
        own = np.isin(row, _reads(change, row)) | ~np.isfinite(one.value)
    else:
        return one
    return Series(one.t_ns[own], one.value[own])


def _beats(rows: Integers) -> bool:
    """Whether changes so many rows apart (n,) follow one beat with jitter.

    Those of a coarse signal come as fast as it moves: some at once, some late. A value that
    happens to be the same again makes two beats of one.
    """
    usual = float(np.median(rows))
    if usual < LEAST_STEPS:
        return False
    beats = np.maximum(np.rint(rows / usual), 1.0)
    off = np.abs(rows - beats * usual) / (beats * usual)
    return bool(np.mean((beats <= _MOST_BEATS) & (off <= _JITTER)) >= _REGULAR)


def _reads(change: Integers, row: Integers) -> Integers:
    """Rows at which it was read: its changes, and between them where it was the same again."""
    usual = float(np.median(np.diff(change)))
    ends = np.concatenate([change, [row[-1] + 1]])
    beats = np.maximum(np.rint(np.diff(ends) / usual), 1.0).astype(np.int64)
    part = np.arange(np.sum(beats)) - np.repeat(np.cumsum(beats) - beats, beats)
    first, length = np.repeat(change, beats), np.repeat(np.diff(ends) / beats, beats)
    return np.asarray(first + np.rint(part * length).astype(np.int64))


def _jumps(row: Integers, change: Integers, value: npt.NDArray[np.float64]) -> bool:
    """Whether most changes are larger than the smallest: a coarse signal goes step by step."""
    at = np.searchsorted(row, change)
    size = np.abs(value[at] - value[at - 1])
    return bool(np.mean(size < 1.5 * np.min(size)) < _STEP_BY_STEP)


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
