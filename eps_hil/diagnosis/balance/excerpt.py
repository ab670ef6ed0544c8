"""Where the search looks in long recordings: windows that show most, and some of everything.

What an effect is called takes minutes of recording, and every candidate costs as much as there is
to look at. Of more than :data:`LONG_S`, the search sees half its time where the model fits worst
and half at even distances; what it finds is then fitted and judged on all of it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import ALL
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee
from eps_hil.diagnosis.data.prepare import STEP_S, THIN, Prepared

Floats = npt.NDArray[np.float64]
Cut = tuple[Prepared, int]
"""A recording, and the sample at which a window of it begins."""

LONG_S = 400.0
"""Recordings of no more than this, all together, are searched as a whole."""
SEARCHED_S = 240.0
WINDOW_S = 12.0

_LENGTH = round(WINDOW_S / STEP_S / THIN) * THIN
_HALF = round(SEARCHED_S / WINDOW_S / 2)


def evenly(recordings: Sequence[Prepared]) -> Sequence[Prepared]:
    """The recordings or, of long ones, windows at even distances: SEARCHED_S of them in all.

    For what is the same all the time and has no memory.
    """
    if not _long(recordings):
        return recordings
    cuts = _windows(recordings)
    count = round(SEARCHED_S / WINDOW_S)
    return [_window(*cuts[k]) for k in sorted(_spread(len(cuts), count))]


def excerpt(problem: Problem) -> Problem:
    """The problem itself or, of a long one, one over windows of its recordings.

    Without a measured place (an angle that is summed up starts anew in each window) a long one is
    searched as a whole too.
    """
    recordings = problem.recordings
    placed = all({"motor_angle_rad", "rack_position_m"} & one.raw.keys() for one in recordings)
    if not placed or not _long(recordings):
        return problem
    cuts = _windows(recordings)
    even = _spread(len(cuts), _HALF)
    excess = _excess(problem, [cuts[k] for k in sorted(even)])
    by_excess = sorted(range(len(cuts)), key=lambda k: (-excess[k], k))
    worst = [k for k in by_excess if k not in even][:_HALF]
    return _over(problem, [cuts[k] for k in sorted({*even, *worst})])


def only_part(problem: Problem, part: Problem) -> list[str]:
    """What a reader has to know of a search that did not see everything; [] if it did."""
    if part is problem:
        return []
    return [
        f"Names were searched for in {_seconds(part.recordings):.0f} s of the recordings' "
        f"{_seconds(problem.recordings):.0f} s: where the model fits worst, and at even distances. "
        "What was found is fitted and judged on all; a small effect that shows in few places only "
        "may have been missed. Recordings of those places alone would show it."
    ]


def _seconds(recordings: Sequence[Prepared]) -> float:
    return sum(len(one.time_s) for one in recordings) * STEP_S


def _long(recordings: Sequence[Prepared]) -> bool:
    return _seconds(recordings) > LONG_S


def _starts(one: Prepared) -> range:
    """Where windows begin: as many as are whole, at least one."""
    return range(0, max(len(one.time_s) - _LENGTH, 0) + 1, _LENGTH)


def _windows(recordings: Sequence[Prepared]) -> list[Cut]:
    return [(one, first) for one in recordings for first in _starts(one)]


def _spread(count: int, chosen: int) -> set[int]:
    return {round(k) for k in np.linspace(0, count - 1, chosen)}


def _window(one: Prepared, first: int) -> Prepared:
    return one.cut(first, first + _LENGTH)


def _over(problem: Problem, cuts: Sequence[Cut]) -> Problem:
    windows = [_window(*cut) for cut in cuts]
    part = replace(problem, recordings=windows, remainder=None)
    part.visited_m = problem.visited_m
    part.farthest_m, part.extreme_m = problem.farthest_m, problem.extreme_m
    return part


def _excess(problem: Problem, even: Sequence[Cut]) -> list[float]:
    """For each window of the whole, what a refit of the model's own numbers leaves beyond noise."""
    own = fit(_over(problem, even), [], own={**ALL, **problem.tied}).own
    residual = problem.residual(problem.with_entries([], own))
    beyond = np.where(problem.sliding, clipped(residual, knee(residual)) ** 2 - 1.0, 0.0)
    found, start = [], 0
    for one in problem.recordings:
        here = beyond[start : start + len(one.thin_time_s)]
        found += [
            float(np.sum(here[first // THIN : (first + _LENGTH) // THIN])) for first in _starts(one)
        ]
        start += len(here)
    return found
