"""Where a mismatch sits: in operating region and in time, as shares of its energy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.coordinates import coordinates_of
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import THIN
from eps_hil.diagnosis.mismatch.binned import places

Floats = npt.NDArray[np.float64]

BINS = 24
_MOST_OF_IT, _CLEARLY = 0.85, 0.1
_NOTHING = 0.01
"""Share of the energy below which a side of an interval is moved in."""
_SEGMENT_S = 0.5
_MOST_SEGMENTS = 6


@dataclass(frozen=True)
class Region:
    """An interval of one signal and the share of the energy inside it."""

    signal: str
    low: float
    high: float
    share: float
    occupancy: float


def coordinates(problem: Problem) -> Mapping[str, Floats]:
    """Canonical signals at the thinned samples, physical instants, all shape (n,)."""
    return coordinates_of(problem.recordings, problem.model)


def where(problem: Problem, energy: Floats, over_time: bool = True) -> list[Region]:
    """The two signals in whose intervals ``energy`` (n,) is most concentrated, best first.

    Without ``over_time`` a recording's time is none of them: it is where a manoeuvre was. A signal
    has two intervals where what happens, happens in both directions (an end stop).
    """
    total = float(np.sum(energy))
    if total <= 0.0:
        return []
    found = []
    for name, values in coordinates(problem).items():
        if name == "time_s" and not over_time:
            continue
        one = interval(name, values, energy / total)
        both = _both_ways(name, values, energy / total)
        parts = [one] if one else []
        if both and _stands_out(both) > _stands_out(parts) + _CLEARLY:
            parts = both
        if _stands_out(parts) > _CLEARLY:
            found.append(parts)
    best = sorted(found, key=_stands_out, reverse=True)[:2]
    return [region for parts in best for region in parts]


def _stands_out(parts: Sequence[Region]) -> float:
    return sum(one.share - one.occupancy for one in parts)


def _both_ways(name: str, values: Floats, share: Floats) -> list[Region]:
    """The same interval of a signal's size in both its directions; none where one would do."""
    size = np.abs(values)
    band = interval(name, size, share)
    if band is None or band.low <= np.min(size):
        return []
    rising = np.argsort(size)
    rising = rising[(size[rising] >= band.low) & (size[rising] <= band.high)]
    sums = np.cumsum(share[rising])
    least = float(size[rising[np.searchsorted(sums, _NOTHING * sums[-1])]])
    sides = []
    for low, high in ((-band.high, -least), (least, band.high)):
        inside = (low <= values) & (values <= high)
        sides.append(Region(name, low, high, float(share[inside].sum()), float(inside.mean())))
    return sides if min(one.share for one in sides) > _CLEARLY else []


def interval(name: str, values: Floats, share: Floats) -> Region | None:
    """The interval of fewest samples that holds most of the energy."""
    edges = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)))
    if len(edges) < 4:
        return None
    index = places(edges, values)
    inside = np.bincount(index, weights=share, minlength=len(edges) - 1)
    count = np.bincount(index, minlength=len(edges) - 1) / len(values)
    best: Region | None = None
    for i in range(len(inside)):
        for j in range(i + 1, len(inside) + 1):
            part = float(np.sum(inside[i:j]))
            if part < _MOST_OF_IT:
                continue
            occupancy = float(np.sum(count[i:j]))
            if best is None or occupancy < best.occupancy:
                best = Region(name, float(edges[i]), float(edges[j]), part, occupancy)
            break
    return best


def time_segments(problem: Problem, excess: Floats) -> Sequence[tuple[str, float, float, float]]:
    """(recording, from s, to s, share of excess) of the worst stretches, worst first."""
    total = float(np.sum(np.maximum(excess, 0.0)))
    found = []
    start = 0
    for recording in problem.recordings:
        n = len(recording.thin_time_s)
        energy = np.maximum(excess[start : start + n], 0.0)
        start += n
        per = max(1, round(_SEGMENT_S / (THIN * 1e-3)))
        sums = np.add.reduceat(energy, np.arange(0, n, per))
        high = sums > 2.0 * total / max(1, len(excess) / per)
        for i, j in _runs(high):
            share = float(np.sum(sums[i:j])) / max(total, 1e-300)
            first = float(recording.thin_time_s[i * per])
            last = float(recording.thin_time_s[min(j * per, n) - 1])
            found.append((recording.name, first, last, share))
    return sorted(found, key=lambda one: -one[3])[:_MOST_SEGMENTS]


def by_recording(problem: Problem, excess: Floats) -> list[dict[str, Any]]:
    """Of each recording the share of ``excess`` (n,) and of the time that slides."""
    energy = np.where(problem.sliding, np.maximum(excess, 0.0), 0.0)
    total, time = max(float(np.sum(energy)), 1e-300), max(int(np.sum(problem.sliding)), 1)
    told, start = [], 0
    for recording in problem.recordings:
        part = slice(start, start + len(recording.thin_time_s))
        start = part.stop
        told.append(
            {
                "recording": recording.name,
                "share_of_excess": round(float(np.sum(energy[part])) / total, 4),
                "share_of_time": round(int(np.sum(problem.sliding[part])) / time, 4),
            }
        )
    return told


def _runs(high: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], high.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
