"""A free curve over rack position: where its knots go, and its values beside everything else.

Equally spaced knots blur a narrow step and waste themselves on straight parts. Here a knot goes
where the residual's profile over position still bends, as long as it earns its price.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import OFFSET, OFFSET_NM
from eps_hil.diagnosis.balance.fit import Fit, fit
from eps_hil.diagnosis.balance.probes import hats
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee
from eps_hil.diagnosis.mismatch.locate import coordinates
from eps_hil.physics.effects.catalogue import catalogue

Floats = npt.NDArray[np.float64]

ID = "position_torque"
MOST_KNOTS = 30
_CELLS = 360
_LEAST_IN_CELL = 4
_TRIALS = 5
_LEAST_PROFILE = 12
_WAY, _FLAT = 101, 0.3
_STEPS = 2
"""The first step is taken beside a model without the curve, where outliers are guessed."""
_CLEAR_OF_ZERO = 0.1
MOST_SWINGS, _SWING = 4, 0.35
"""A curve goes up or down by so much of its height, as a swing counts, so many times at most."""


def knots(problem: Problem, residual: Floats) -> list[float]:
    """Positions (m), ascending, between which the profile of ``residual`` is straight enough.

    Knots are added one at a time in the span with the largest misfit in which one lowers the misfit
    by Schwarz's price, until there is none. Empty where too little way was covered.
    """
    place, mean, weight = _profile(problem, residual)
    if len(place) < _LEAST_PROFILE:
        return []
    price = 2.0 * float(np.log(len(residual)))
    chosen = [float(place[0]), float(place[-1])]
    misfit, left = _straight(chosen, place, mean, weight)
    while len(chosen) < MOST_KNOTS:
        for trials in _trials(chosen, place, left, price):
            found = [(_straight(sorted([*chosen, x]), place, mean, weight)[0], x) for x in trials]
            best, x = min(found)
            if misfit - best > price:
                chosen = sorted([*chosen, x])
                misfit, left = _straight(chosen, place, mean, weight)
                break
        else:
            break
    return chosen


def _profile(problem: Problem, residual: Floats) -> tuple[Floats, Floats, Floats]:
    """Cells over position that were slid through: place, mean residual, weight of the mean."""
    use = problem.sliding
    values = _without_outliers(problem, residual)[use]
    edges, cell = _cells(problem)
    cell, n = cell[use], len(edges) - 1
    inside = (cell >= 0) & (cell < n)
    count: Floats = np.bincount(cell[inside], minlength=n).astype(np.float64)
    total = np.bincount(cell[inside], weights=values[inside], minlength=n)
    square = np.bincount(cell[inside], weights=values[inside] ** 2, minlength=n)
    good = count >= _LEAST_IN_CELL
    mean = total[good] / count[good]
    scatter = square[good] / count[good] - mean**2
    usual = float(np.median(scatter)) if len(scatter) else 0.0  # not that of one bad cell
    centre = 0.5 * (edges[1:] + edges[:-1])
    return centre[good], mean, count[good] / np.maximum(scatter, max(usual, 1.0))


def _cells(problem: Problem) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Edges (m) of the cells over all that was slid through, and each sample's cell.

    Outside, -1 or the number of cells. The rarely visited ends count: a curve that ends before them
    is flat there, and another name would be taken for what it leaves. Where little was seen a cell
    is wider.
    """
    position = coordinates(problem)["rack_position_m"]
    slid = np.sort(position[problem.sliding])
    low, high = (slid[0], slid[-1]) if len(slid) else problem.visited_m
    fine = np.linspace(low, high, _CELLS + 1)
    before, edges = np.searchsorted(slid, fine), [0]
    for k in range(1, _CELLS):
        if before[k] - before[edges[-1]] >= _LEAST_IN_CELL <= len(slid) - before[k]:
            edges.append(k)
    cells = fine[[*edges, _CELLS]]
    return cells, np.searchsorted(cells, position, side="right") - 1


def _without_outliers(problem: Problem, residual: Floats) -> Floats:
    """The residual with outliers cut, each beside the median of its place.

    A strong curve would be cut itself if outliers were judged from zero.
    """
    edges, cell = _cells(problem)
    n = len(edges) - 1
    middle = np.zeros(n + 2)
    order = np.argsort(cell, kind="stable")
    order = order[problem.sliding[order]]
    bounds = np.searchsorted(cell[order], np.arange(n + 1))
    for k in range(n):
        inside = residual[order[bounds[k] : bounds[k + 1]]]
        if len(inside) >= _LEAST_IN_CELL:
            middle[k] = np.median(inside)
    beside = residual - middle[cell]  # outside the cells: -1 and n, zeros both
    return np.asarray(middle[cell] + clipped(beside, knee(beside)))


def _straight(
    chosen: Sequence[float], place: Floats, mean: Floats, weight: Floats
) -> tuple[float, Floats]:
    """(misfit, each cell's share of it) of the best curve that is straight between knots."""
    root = np.sqrt(weight)
    hat = np.column_stack([np.interp(place, chosen, row) for row in np.eye(len(chosen))])
    values = np.linalg.lstsq(hat * root[:, None], mean * root, rcond=1e-6)[0]
    left = weight * (mean - hat @ values) ** 2
    return float(np.sum(left)), left


def _trials(
    chosen: Sequence[float], place: Floats, left: Floats, price: float
) -> Iterator[list[float]]:
    """A few places for a new knot in each span of more misfit than ``price``, worst first."""
    span = np.clip(np.searchsorted(chosen, place, side="right") - 1, 0, len(chosen) - 2)
    misfit = np.bincount(span, weights=left, minlength=len(chosen) - 1)
    for worst in np.argsort(-misfit):
        inside = place[span == worst][1:-1]
        if not len(inside) or misfit[worst] < price:
            continue
        picks = np.linspace(0, len(inside) - 1, _TRIALS + 2)[1:-1].round().astype(int)
        trials = [float(x) for x in inside[np.unique(picks)] if x not in chosen]
        if trials:
            yield trials


def with_curve(problem: Problem, found: Fit) -> Fit:
    """The fit with its curve's knots and values found anew, or with a first curve, beside all else.

    Everything else moves in the same linear step, and is then fitted around the curve. The fit as
    it was, where no curve is worth its knots. The curve is zero where it is flattest: a constant
    torque has names of its own.
    """
    others = [dict(entry) for entry in found.entries if entry["effect"] != ID]
    bare = found if len(others) == len(found.entries) else fit(problem, others, 0, found.own)
    places = knots(problem, bare.residual)
    if len(places) < 3:
        return found
    columns = hats(problem, (others, found.own), catalogue()[ID], places, bare.residual)
    way = np.linspace(*problem.visited_m, _WAY)
    trial, torque = bare, np.zeros(len(places))
    left = _without_outliers(problem, bare.residual)
    for _ in range(_STEPS):
        torque = torque + _jointly(columns, trial, left)
        torque = torque - _level(np.interp(way, places, torque))
        curve = [[x, float(y)] for x, y in zip(places, torque, strict=True)]
        entry: Mapping[str, Any] = {"effect": ID, "curve": curve}
        beside = [one for one in trial.entries if one["effect"] != ID]
        trial = fit(problem, [*beside, entry], own=trial.own, like=bare)
        left = clipped(trial.residual, knee(trial.residual))
    return trial


def _jointly(columns: Floats, found: Fit, left: Floats) -> Floats:
    """By how much the curve's values (k,) change in a linear step of all numbers of ``found``.

    ``columns`` (n, k): what each value takes off the residual; ``left`` (n,): that residual.
    """
    curve, own = columns.shape[1], len(found.own)
    everything = np.column_stack([columns, -found.jacobian])
    prior = np.zeros(everything.shape[1])
    prior[curve : curve + own] = 1.0
    normal = everything.T @ everything + np.diag(prior)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-30))  # a column may be all zero
    step = np.linalg.lstsq(normal / np.outer(size, size), everything.T @ left / size, rcond=1e-9)
    return np.asarray((step[0] / size)[:curve])


def has_curve(found: Fit) -> bool:
    """Whether a curve over position is one of the fit's entries."""
    return any(entry["effect"] == ID for entry in found.entries)


def winds(entry: Mapping[str, Any], visited_m: tuple[float, float]) -> bool:
    """Whether an entry's curve goes to and fro too often for a place on the rack.

    That is a pattern which has a name of its own, or none. The rarely visited ends beyond
    ``visited_m`` do not count: a stop there is no part of a pattern.
    """
    place, drawn = zip(*entry.get("curve", [(0.0, 0.0)]), strict=True)
    low, high = visited_m
    inside = [low, *(x for x in place if low < x < high), high]
    torque = [float(y) for y in np.interp(inside, place, drawn)]
    least = _SWING * (max(torque) - min(torque))
    low = high = torque[0]
    swings, up = 0, 0
    for y in torque:
        if up != 1 and y - low > least:
            swings, up, high = swings + 1, 1, y
        elif up != -1 and high - y > least:
            swings, up, low = swings + 1, -1, y
        low, high = min(low, y), max(high, y)
    return swings > MOST_SWINGS


def levelled(problem: Problem, found: Fit) -> Fit | None:
    """The fit with its constant torque put into the curve; None where that lifts it off zero.

    Where a curve is zero is a matter of how it is drawn. A curve that keeps clear of zero by a
    part of its height holds a constant torque besides.
    """
    constant_nm = OFFSET_NM * problem.size.torque * found.own.get(OFFSET, 0.0)
    (curve,) = (entry["curve"] for entry in found.entries if entry["effect"] == ID)
    raised = [[x, y - constant_nm] for x, y in curve]
    low, high = min(y for _, y in raised), max(y for _, y in raised)
    if max(low, -high) > _CLEAR_OF_ZERO * (high - low):
        return None
    entries = [{**one, "curve": raised} if one["effect"] == ID else one for one in found.entries]
    own = {name: value for name, value in found.own.items() if name != OFFSET}
    return fit(problem, entries, own=own, like=found)


def _level(torque: Floats) -> float:
    """The torque about which most of the way lies closest together."""
    ordered = np.sort(torque)
    n = round(_FLAT * len(ordered))
    first = int(np.argmin(ordered[n:] - ordered[:-n]))
    return float(np.mean(ordered[first : first + n + 1]))
