"""What no effect of the catalogue explains: a reproducible curve over some measured coordinate."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import HOLD, HOLD_S
from eps_hil.diagnosis.balance.fit import Fit, fit
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee
from eps_hil.diagnosis.mismatch.binned import gain_elsewhere, means, places, points
from eps_hil.diagnosis.mismatch.locate import BINS, coordinates
from eps_hil.physics.effects.catalogue import catalogue

Floats = npt.NDArray[np.float64]

LEAST_EXCESS = 0.12
"""Residual energy beyond the sensor noise, as a share of it, below which nothing is left."""
LEAST_SHARE = 0.03
"""Least share of the residual energy that a curve explains on blocks it was not drawn from."""
LARGE_EXCESS = 0.3
"""Beyond this, in the median sample too, something is missing even if no curve shows it."""
HUGE_EXCESS = 0.6
"""Beyond this something is missing even if only some samples show it."""
BESIDE_UNKNOWN = 2.0
"""Times the energy that stays unexplained: what a name has to explain, to be one beside it."""
_TAIL = (0.002, 0.005, 0.01, 0.02)
_CUTS = np.unique([*np.linspace(0, 1, BINS + 1), *_TAIL, *(1.0 - one for one in _TAIL)])
"""Where bins end, as shares of the samples: finer where one is seldom, as at an end stop."""
_LEAST_HELD_S, _CLEARLY_HELD = 1.5e-4, 100.0
"""How late a torque is, and what that gains in noise variances, to be worth a sentence."""
_FEWEST = 4
"""Samples of a bin that count."""
_MEDIAN_OF_SQUARE = 0.4549
"""Of a standard normal variable: outliers move the mean square, not this."""


@dataclass(frozen=True)
class Leftover:
    """A significant remainder: over which signals, how large, and its curve (x, Nm, band Nm)."""

    signal: str
    curve: tuple[tuple[float, float, float], ...]
    low: float
    high: float
    share: float
    excess: float
    words: str = ""
    """What it looks like, where that is no curve over a signal."""


def leftover(
    problem: Problem, residual: Floats, judged: tuple[Problem, Floats] | None = None
) -> Leftover | None:
    """The best one-coordinate description of what is left while sliding, if it matters.

    A curve must hold on blocks that it was not drawn from, or on hold-outs: ``judged``, their
    problem and what the same model leaves of them. What happened once can only show there.
    """
    use = problem.sliding
    cut = clipped(residual, knee(residual))
    energy = float(np.mean(cut[use] ** 2))
    excess = energy - 1.0
    if excess < LEAST_EXCESS:
        return None
    best: Leftover | None = None
    others = {} if judged is None else _views(judged[0])
    for name, values in _views(problem).items():
        found = _curve(problem, name, values, cut, excess)
        if found is not None and judged is not None and name != "time_s":
            found = _seen_again(found, judged, others[name])
        if found is not None and (best is None or found.share > best.share):
            best = found
    if best is not None and best.share > LEAST_SHARE:
        return best
    typical = float(np.median(residual[use] ** 2)) / _MEDIAN_OF_SQUARE - 1.0
    if min(excess, typical) > LARGE_EXCESS or excess > HUGE_EXCESS:
        low, high = np.percentile(coordinates(problem)["motor_speed_rad_s"], [2, 98])
        return Leftover("motor_speed_rad_s", (), float(low), float(high), 0.0, excess)
    return None


def late_torque(problem: Problem, found: Fit) -> Leftover | None:
    """A motor torque that is later than holding it explains, where no name for that is allowed."""
    late_s = HOLD_S * found.own.get(HOLD, 0.0)
    if abs(late_s) < _least_late_s():
        return None
    excess = _of_being_late(problem, found) / max(float(np.sum(problem.sliding)), 1.0)
    low, high = np.percentile(coordinates(problem)["motor_torque_nm"], [2, 98])
    words = f"as if the motor's torque acted {1e3 * late_s:.2g} ms later than the model file says"
    return Leftover("motor_torque_nm", (), float(low), float(high), 1.0, excess, words)


def how_held(problem: Problem, found: Fit) -> list[str]:
    """A sentence where the motor's torque is clearly later or earlier by too little for a name."""
    late_s = HOLD_S * found.own.get(HOLD, 0.0)
    if abs(late_s) < _LEAST_HELD_S or _of_being_late(problem, found) < _CLEARLY_HELD:
        return []
    fits_s = max(problem.model.delays_s.motor_torque - late_s, 0.0)
    word = "later" if late_s > 0.0 else "earlier"
    return [
        f"The motor's torque acts {1e3 * abs(late_s):.2g} ms {word} than the model file says: so "
        "little may be how a torque is held between samples, and is no finding. delays_s: "
        f"motor_torque: {fits_s:.2g} would fit; a model written with findings has it."
    ]


def _of_being_late(problem: Problem, found: Fit) -> float:
    """What it gains, in noise variances, that the motor's torque may be late by a part of 1 ms."""
    others = {name: value for name, value in found.own.items() if name != HOLD}
    return fit(problem, found.entries, own=others, like=found).cost - found.cost


def _least_late_s() -> float:
    probe = catalogue()[HOLD].probe
    assert probe is not None
    return probe.least


def _views(problem: Problem) -> Mapping[str, Floats]:
    """Coordinates as they are, and split by the direction of movement (``|right``, ``|left``)."""
    plain = coordinates(problem)
    speed = plain["motor_speed_rad_s"]
    views = dict(plain)
    for name, values in plain.items():
        if name not in ("motor_speed_rad_s", "time_s"):
            views[f"{name}|right"] = np.where(speed > 0, values, np.nan)
            views[f"{name}|left"] = np.where(speed < 0, values, np.nan)
    return views


def _seen_again(found: Leftover, judged: tuple[Problem, Floats], values: Floats) -> Leftover:
    """The curve with the share that it explains of the hold-outs, if that is the larger."""
    problem, residual = judged
    use = problem.sliding & np.isfinite(values)
    cut = clipped(residual, knee(residual))
    x = [point[0] for point in found.curve]
    guess = np.interp(values[use], x, [point[1] for point in found.curve]) / problem.scale[use]
    gain = float(np.sum(cut[use] ** 2 - (cut[use] - guess) ** 2))
    share = gain / max(float(np.sum(cut[problem.sliding] ** 2)), 1e-300)
    return replace(found, share=max(found.share, share))


def _curve(
    problem: Problem, name: str, values: Floats, residual: Floats, excess: float
) -> Leftover | None:
    use = problem.sliding & np.isfinite(values)
    if np.sum(use) < 20 * BINS:
        return None
    edges = np.unique(np.quantile(values[use], _CUTS))
    if len(edges) < 6:
        return None
    place, n = places(edges, values[use]), len(edges) - 1
    total = float(np.sum(residual[problem.sliding] ** 2))
    gain = gain_elsewhere(place, residual[use], problem.block[use], n, _FEWEST)
    torque = (residual * problem.scale)[use]
    mean = means(place, torque, n, _FEWEST)
    spread = np.sqrt(means(place, torque**2, n, _FEWEST))
    band = 2.0 * spread / np.sqrt(np.maximum(np.bincount(place, minlength=n), 1))
    strong = np.flatnonzero(np.abs(mean) > 0.5 * np.max(np.abs(mean)))
    low, high = float(edges[strong[0]]), float(edges[strong[-1] + 1])
    curve = points(edges, mean, band)
    return Leftover(name, curve, low, high, gain / max(total, 1e-300), excess)
