"""One cyclic message: period, lateness, losses, steps of its stamps.

A receive stamp is late by schedulers, arbitration and drivers, and never early; so the sender's
instants lie on the lower envelope of the stamps. The envelope is taken over blocks and is a
straight line, but for steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from eps_hil.clocks.jumps import CYCLIC, FEWEST

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

NOMINAL_MS = (
    *(0.25, 0.5, 1, 2, 2.5, 4, 5, 8, 10, 12.5, 15, 16, 20, 25, 30, 32, 40, 50, 60, 80),
    *(100, 120, 160, 200, 250, 500, 1000, 2000),
)
"""Cycle times that are in use; a sender's quartz is within :data:`QUARTZ` of one of them."""
QUARTZ = 500e-6
_BLOCK_S = 0.5
_MOST_BLOCKS = 600
"""Of a long log; the search for a step takes the square of it."""
_FEWEST_BLOCKS = 12
_STEP_SIGMA, LEAST_STEP_NS = 6.0, 30_000.0
_LESS = 0.9
"""Of the scatter without it: a step that leaves more is none."""
_MOST_STEPS = 8
_EDGE = 3
"""Blocks at either end, and between steps, in which no step is looked for."""
_RESOLUTIONS_NS = tuple(10**k for k in range(9, -1, -1))
_MOST_FITTED = 100_000
_LOW = 5.0
"""Percentile of a block's stamps that stands for its earliest: a frame that is late by most of a
cycle looks early in the next one, and there are few of those."""
_IN_A_ROW = 6
"""Frames that one late frame holds up at most, each in the cycle of the next."""
_COARSE = 1.5
"""Resolutions of the stamps below which a step is rounding."""


@dataclass(frozen=True, slots=True)
class Step:
    """Stamps from ``at_s`` (after the channel's first stamp) on are later by ``by_s``."""

    at_s: float
    by_s: float
    sigma_s: float


@dataclass(frozen=True, slots=True)
class Cadence:
    """A cyclic message's clock as the logger saw it.

    ``period_s``: by the logger's clock. ``nominal_s``: the usual cycle time next to it, None where
    none is within 500 ppm. ``drift_ppm``, ``drift_ci95``: how much slower than nominal the sender
    runs by the logger's clock. ``late_p50_s``, ``late_p99_s``, ``late_max_s``: of the stamps beyond
    the envelope. ``lost``: cycles without a frame. ``at_jumps``: what is left of known jumps of the
    clock, as far as this message tells.
    """

    frames: int
    period_s: float
    nominal_s: float | None
    drift_ppm: float | None
    drift_ci95: tuple[float, float] | None
    late_p50_s: float
    late_p99_s: float
    late_max_s: float
    lost: int
    steps: tuple[Step, ...]
    envelope_s: float
    """Deviation of the envelope's blocks from the line: what the clock's own noise is."""
    block_s: float
    at_jumps: tuple[Step, ...] = ()


def resolution_ns(t_ns: Integers) -> int:
    """The coarsest decimal step that all stamps are multiples of."""
    for step in _RESOLUTIONS_NS:
        if not np.any(t_ns % step):
            return step
    return 1


def cadence(
    t_ns: Integers, start_ns: int, resolution: int = 1, jumps_s: Sequence[float] = ()
) -> Cadence | None:
    """The clock of one message; None where it has too few frames or is not cyclic.

    ``t_ns`` (n,): stamps; ``start_ns``: where times count from; ``resolution``: of stamps, ns;
    ``jumps_s``: when jumps were that have been taken out roughly.
    """
    if len(t_ns) < FEWEST:
        return None
    t = np.sort(t_ns - start_ns).astype(np.float64) * 1e-9
    usual = float(np.median(np.diff(t)))
    low, high = np.percentile(np.diff(t), [25, 75])
    if usual <= 0.0 or high - low > 2.0 * CYCLIC * usual:
        return None
    cycle, period = _cycles(t, usual)
    cycles = float(cycle[-1] - cycle[0])
    per_block = max(round(_BLOCK_S / period), 8, int(np.ceil(cycles / _MOST_BLOCKS)))
    place, low_s = _envelope(t, cycle, period, per_block)
    if len(place) < _FEWEST_BLOCKS:
        return None
    least_s = max(LEAST_STEP_NS, _COARSE * resolution) * 1e-9
    first_s = float(t[0] - cycle[0] * period)
    line = line_with_steps(place * period, low_s, least_s, [at - first_s for at in jumps_s])
    late = np.maximum(t - cycle * period - line.at(cycle * period), 0.0)
    period *= 1.0 + line.slope
    nominal = min((ms * 1e-3 for ms in NOMINAL_MS), key=lambda one: abs(period / one - 1.0))
    near = abs(period / nominal - 1.0) < QUARTZ
    ppm = 1e6 * (period / nominal - 1.0)
    half = 1e6 * (1.96 * line.slope_sigma + resolution * 1e-9 / max(float(t[-1] - t[0]), 1e-9))
    p50, p99 = np.percentile(late, [50, 99])
    return Cadence(
        frames=len(t),
        period_s=period,
        nominal_s=nominal if near else None,
        drift_ppm=ppm if near else None,
        drift_ci95=(ppm - half, ppm + half) if near else None,
        late_p50_s=float(p50),
        late_p99_s=float(p99),
        late_max_s=float(np.max(late)),
        lost=max(int(cycle[-1] - cycle[0]) + 1 - len(t), 0),
        steps=tuple(_later(one, first_s) for one in line.steps if one.at_s not in line.known_s),
        envelope_s=line.spread_s,
        block_s=per_block * period,
        at_jumps=tuple(_later(one, first_s) for one in line.steps if one.at_s in line.known_s),
    )


def located(step: Step, t_ns: Integers, start_ns: int, told: Cadence) -> Step:
    """A step of one message at the very frame, not between two blocks."""
    near = 2.0 * told.block_s
    t = np.sort(t_ns - start_ns) * 1e-9
    t = t[slice(*np.searchsorted(t, [step.at_s - near, step.at_s + near]))]
    first = t[t < step.at_s - 0.5 * told.block_s]
    if len(first) < 4:
        return step
    period = told.period_s
    rest = (t - t[0] + 0.5 * period) % period - 0.5 * period
    rest = (rest - float(np.median(rest[: len(first)])) + 0.25 * period) % period - 0.25 * period
    by = (step.by_s + 0.25 * period) % period - 0.25 * period
    k = _where(rest, by)
    while 0 < k < len(t) - 1 and t[k] - by < t[k - 1]:  # a late frame before it: none overtakes
        k += 1
    return replace(step, at_s=float(t[k]))


def _later(step: Step, by_s: float) -> Step:
    return replace(step, at_s=step.at_s + by_s)


def _cycles(t: Floats, usual: float) -> tuple[Floats, float]:
    """The number of each frame's cycle and the period, from a window that doubles each time."""
    period, first = usual, float(t[0])
    hi = min(FEWEST, len(t))
    while True:
        some = t[: hi : hi // _MOST_FITTED + 1]
        cycle = np.round((some - first) / period)
        for _ in range(3):
            rest = some - first - cycle * period
            centre = float(np.median(rest))
            good = np.abs(rest - centre) < 0.25 * period
            if np.sum(good) < 8:
                break
            slope, level = np.polyfit(cycle[good], some[good], 1)
            period, first = float(slope), float(level)
            cycle = np.round((some - first) / period)
        if hi == len(t):
            return _in_order(np.round((t - first) / period)), period
        hi = min(2 * hi, len(t))


def _in_order(cycle: Floats) -> Floats:
    """No two frames in one cycle where the cycle before is free: the earlier one was late."""
    cycle = cycle.copy()
    for k in np.flatnonzero(np.diff(cycle) <= 0).tolist():
        for j in range(k, max(k - _IN_A_ROW, -1), -1):
            if cycle[j] < cycle[j + 1]:
                break
            free = j == 0 or cycle[j - 1] <= cycle[j + 1] - 1
            if not free:
                break
            cycle[j] = cycle[j + 1] - 1
    return cycle


def _envelope(t: Floats, cycle: Floats, period: float, per_block: int) -> tuple[Floats, Floats]:
    """Place (in cycles) and time beyond the mean line of each block's earliest frames."""
    rest = t - cycle * period
    block = (cycle - cycle[0]) // per_block
    first = np.flatnonzero(np.diff(block, prepend=block[0] - 1))
    places, lows = [], []
    for a, b in zip(first, [*first[1:], len(t)], strict=True):
        if b - a >= max(4, per_block // 4):
            places.append(float(np.mean(cycle[a:b])))
            lows.append(float(np.percentile(rest[a:b], _LOW)))
    return np.array(places), np.array(lows)


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line with steps: level and slope at ``middle_s``, what each cut adds; seconds."""

    middle_s: float
    cuts_s: tuple[float, ...]
    numbers: Floats
    errors: Floats
    spread_s: float
    known_s: tuple[float, ...] = ()
    """Those of the cuts that were given."""

    @property
    def slope(self) -> float:
        """Seconds per second."""
        return float(self.numbers[1])

    @property
    def slope_sigma(self) -> float:
        """Deviation of the slope."""
        return float(self.errors[1])

    @property
    def steps(self) -> tuple[Step, ...]:
        """What is added from each cut on."""
        return tuple(
            Step(at, float(self.numbers[2 + j]), float(self.errors[2 + j]))
            for j, at in enumerate(self.cuts_s)
        )

    def at(self, at_s: Floats) -> Floats:
        """Its values (n,) at times (n,)."""
        after = [(at_s >= cut).astype(np.float64) for cut in self.cuts_s]
        columns = np.column_stack([np.ones(len(at_s)), at_s - self.middle_s, *after])
        return np.asarray(columns @ self.numbers)


def line_with_steps(
    at_s: Floats, low_s: Floats, least_s: float, known_s: Sequence[float] = ()
) -> Line:
    """The line through blocks (n,); steps of ``least_s`` or more, and those at ``known_s``.

    A step is taken where it is clear of the blocks' scatter and that falls by a tenth by it.
    """
    cuts = _known_cuts(at_s, known_s)
    known = tuple(float(0.5 * (at_s[k - 1] + at_s[k])) for k in cuts)
    line = _solved(at_s, low_s, cuts)
    most = _MOST_STEPS + len(cuts)
    while len(cuts) < most:
        usable = [
            k for k in range(_EDGE, len(at_s) - _EDGE) if all(abs(k - one) >= _EDGE for one in cuts)
        ]
        if not usable:
            break
        k = min(usable, key=lambda one: _left(at_s, low_s, sorted([*cuts, one])))
        more = sorted([*cuts, k])
        trial = _solved(at_s, low_s, more)
        step = trial.steps[more.index(k)]
        clear = abs(step.by_s) > max(_STEP_SIGMA * step.sigma_s, least_s)
        if not clear or trial.spread_s > _LESS * line.spread_s:
            break
        cuts, line = more, trial
    return replace(line, known_s=known)


def moved_to(line: Line, at_s: Floats, low_s: Floats) -> Line:
    """The line with each cut at the very sample of (n,), not between two blocks of them."""
    cuts = []
    for at, step in zip(line.cuts_s, line.steps, strict=True):
        edges = sorted([*line.cuts_s, at_s[0], at_s[-1]])
        before = max(one for one in edges if one <= at and one != at)
        after = min(one for one in edges if one > at)
        a, b = np.searchsorted(at_s, [0.5 * (before + at), 0.5 * (at + after)])
        rest = low_s[a:b] - line.at(at_s[a:b]) + step.by_s * (at_s[a:b] >= at)
        cuts.append(float(at_s[a:b][_where(rest, step.by_s)]))
    return replace(line, cuts_s=tuple(cuts))


def _where(rest: Floats, by: float) -> int:
    """The first of the samples (n,) that are higher by ``by`` than those before them."""
    gain = np.abs(rest - by) - np.abs(rest)  # of what is said of a sample after the step
    total = np.concatenate([[0.0], np.cumsum(gain)])
    return min(int(np.argmax(total)), len(rest) - 1)


def _known_cuts(at_s: Floats, known_s: Sequence[float]) -> list[int]:
    """The blocks that known steps are before; none that would leave less than two to a level."""
    cuts: list[int] = []
    for k in np.searchsorted(at_s, np.sort(np.asarray(known_s, np.float64))).tolist():
        if k - (cuts[-1] if cuts else 0) >= 2 and len(at_s) - k >= 2:
            cuts.append(k)
    return cuts


def _columns(at_s: Floats, cuts: Sequence[int]) -> Floats:
    after = [(np.arange(len(at_s)) >= k).astype(np.float64) for k in cuts]
    return np.column_stack([np.ones(len(at_s)), at_s - np.mean(at_s), *after])


def _solved(at_s: Floats, low_s: Floats, cuts: Sequence[int]) -> Line:
    """Least squares in which blocks that are late as a whole count less (Huber)."""
    columns = _columns(at_s, cuts)
    weight = np.ones(len(at_s))
    for _ in range(6):
        solution = np.linalg.lstsq(columns * weight[:, None], low_s * weight, rcond=None)[0]
        found = np.asarray(solution, np.float64)
        rest = low_s - columns @ found
        scale = 1.4826 * float(np.median(np.abs(rest - np.median(rest)))) + 1e-12
        weight = np.sqrt(np.minimum(1.0, 2.0 * scale / np.maximum(np.abs(rest), 1e-15)))
    weighted = columns * weight[:, None]
    spread = float(np.sqrt(np.sum((weight * rest) ** 2) / max(len(at_s) - columns.shape[1], 1)))
    errors = spread * np.sqrt(np.diag(np.linalg.pinv(weighted.T @ weighted)))
    places = tuple(float(0.5 * (at_s[k - 1] + at_s[k])) for k in cuts)
    return Line(float(np.mean(at_s)), places, found, errors, spread)


def _left(at_s: Floats, low_s: Floats, cuts: Sequence[int]) -> float:
    columns = _columns(at_s, cuts)
    found = np.linalg.lstsq(columns, low_s, rcond=None)[0]
    return float(np.sum(np.abs(low_s - columns @ found)))
