"""Every effect's regressor: the sensitivity of the simulated torque balance to it."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.diagnosis.balance.baseline import STIFFNESS
from eps_hil.diagnosis.balance.problem import TERM, Problem
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.physics.effects.added import MOST_TERMS
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Effect, Parameter, Probe
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

_ORDERS = np.arange(0.5, 50.01, 0.05)
_FINE = np.linspace(-0.05, 0.05, 21)
_MOST_ORDERS = 6
_PARTS = 8
"""Of the periodogram, to be worked out side by side; not by cores, so that all machines agree."""
_FEWEST = 200
"""Samples that an order has to be seen in."""
_APART = 0.3
"""Orders that are nearer are one."""
_FILTER_HZ = 30.0
_KNOTS = 24
_SLOWEST = 4.0
"""Times the longest recording: what fades more slowly is another level."""
_WIDEST = 0.35
"""Of the way that was visited: a place that is wider is none."""

Base = tuple[Sequence[Mapping[str, Any]], Mapping[str, float] | None]
"""Entries, and how far the model's own numbers are moved."""


@dataclass(frozen=True)
class Candidate:
    """One effect in one shape: entries a small amplitude away, and their regressor columns."""

    effect: Effect
    shape: Mapping[str, float]
    columns: Floats
    """(n, 1), or (n, 2) for the two quadratures of a phase."""

    @property
    def repeats(self) -> bool:
        """Whether a rig may have several such terms: one for every order of a turn."""
        return self.effect.probe is not None and self.effect.probe.scan == "order"

    def beside(
        self, entries: Sequence[Mapping[str, Any]], model: Model, angle: float = 1.0
    ) -> bool:
        """Whether this is one term more beside ``entries``, which may hold the effect already.

        ``angle``: how far the rotor turns beside that of an ordinary drive (``size.py``).
        """
        same = [entry for entry in entries if entry["effect"] == self.effect.id]
        if not same or not self.repeats:
            return not same
        near = min(abs(float(entry["order"]) - self.shape["order"]) for entry in same)
        return near * angle > _APART and len(same) < _room(self.effect, model)

    def entry(self, coefficients: Floats, problem: Problem) -> dict[str, Any]:
        """A model file's entry for fitted coefficients, inside the parameters' bounds."""
        probe = self.effect.probe
        assert probe is not None
        neutral = neutral_value(probe, problem.model)
        if probe.scan == "curve":
            knots = [[x, float(y)] for x, y in zip(self.shape.values(), coefficients, strict=True)]
            return {"effect": self.effect.id, probe.amplitude: knots}
        if probe.phase is not None:
            amplitude = float(np.hypot(*coefficients))
            phase = float(np.arctan2(coefficients[1], coefficients[0]))
            values = {probe.amplitude: amplitude, probe.phase: phase}
        else:
            values = {probe.amplitude: _moved_by(float(coefficients[0]), neutral, probe)}
        entry: dict[str, Any] = {"effect": self.effect.id, **self.shape, **values}
        if self.repeats:
            entry[TERM] = f"{self.effect.id} {self.shape['order'] * problem.size.angle:.2f}"
        for parameter in self.effect.parameters:
            if parameter.name in entry:
                low, high = bounds(self.effect, parameter, problem)
                entry[parameter.name] = float(np.clip(entry[parameter.name], low, high))
        return entry


def _moved_by(change: float, neutral: float, probe: Probe) -> float:
    """An amplitude moved as far from ``neutral`` as a small change of it, carried on, asks for.

    Friction turns round over T_fs/σ0: of a stiffness it is that way which is carried on.
    """
    if probe.amplitude != STIFFNESS:
        return neutral + change
    way = 1.0 - change / neutral
    return neutral / way if way > 0.0 else np.inf


def neutral_value(probe: Probe, model: Model) -> float:
    """The value at which the effect is not there (the model file's own where it says so)."""
    if np.isnan(probe.neutral):
        return float(getattr(model.friction, probe.amplitude))
    return probe.neutral


def probe_step(effect: Effect, problem: Problem) -> float:
    """The probe's small change of its amplitude, for a machine of this size."""
    probe = effect.probe
    assert probe is not None
    for one in effect.parameters:
        if one.name == probe.amplitude and one.name != "curve":
            return probe.step * problem.size.of(one, effect)
    return probe.step * problem.size.torque


def _room(effect: Effect, model: Model) -> int:
    """How many terms of the effect the model has room for beside those that it holds."""
    return MOST_TERMS - sum(entry["effect"] == effect.id for entry in model.effects)


def bounds(effect: Effect, parameter: Parameter, problem: Problem) -> tuple[float, float]:
    """Between which values a diagnosis looks for a parameter.

    What the model already holds may be too large in it: only there the other sign means the same.
    A place must have been visited, and be narrow beside the way that was: what is not is a slope.
    So is what takes many times longer than was recorded.
    """
    (low, high), probe = problem.size.bounds(parameter, effect), effect.probe
    if probe is None:
        return low, high
    held = any(entry["effect"] == effect.id for entry in problem.model.effects)
    if probe.one_sided and not (held or problem.either_sign) and parameter.name == probe.amplitude:
        low = max(low, neutral_value(probe, problem.model))
    if probe.lowest is not None and parameter.name == probe.amplitude:
        low = max(low, probe.lowest(problem.model))
    if effect.over_time and parameter.name == "time_s" and not held:
        longest = max(float(one.since_start_s[-1]) for one in problem.recordings)
        high = max(low, min(high, _SLOWEST * longest))
    if probe.scan == "centre_m" and not held:
        first, last = problem.visited_m
        if parameter.name == "centre_m":
            low, high = max(low, min(first, high)), min(high, max(last, low))
        elif parameter.name == "width_m":
            high = max(low, min(high, _WIDEST * (last - first)))
    return low, high


def candidates(
    problem: Problem,
    entries: Sequence[Mapping[str, Any]],
    residual: Floats,
    on_progress: Callable[[float], None] | None = None,
    own: Mapping[str, float] | None = None,
    without: Collection[str] = (),
) -> list[Candidate]:
    """All candidates against the model with ``entries``, whose weighted residual is given.

    ``own``: how far the model's own numbers are moved. Effects whose id is in ``without`` are left
    out. ``on_progress`` is called from any of the threads at work.
    """
    jobs = [
        (effect, shape)
        for effect in catalogue().values()
        if effect.probe is not None and effect.id not in without and _room(effect, problem.model)
        for shape in _shapes(effect, problem, residual)
    ]

    done = count()

    def look(job: tuple[Effect, Mapping[str, float]]) -> Candidate | None:
        effect, shape = job
        base = _bare(effect, entries, own)
        untouched = len(base[0]) == len(entries) and len(base[1]) == len(own or {})
        left = residual if untouched else problem.residual(problem.with_entries(*base))
        columns = _columns(problem, base, effect, shape, left)
        if on_progress:
            on_progress((next(done) + 1) / len(jobs))
        return None if columns is None else Candidate(effect, shape, columns)

    return [one for one in each(look, jobs) if one is not None]


def taken_anew(problem: Problem, pool: Sequence[Candidate]) -> list[Candidate]:
    """The pool where what is left weighs otherwise than when it was taken (``Problem.weigh``).

    Only what changes the noise of a right model has other sensitivities by that.
    """

    def look(one: Candidate) -> Candidate:
        base = _bare(one.effect, [], problem.at)
        probe, model = one.effect.probe, problem.with_entries(*base)
        assert probe is not None
        if probe.scan == "curve" or probe.phase is not None:
            return one
        changed = problem.with_entries([*base[0], _probed(one.effect, one.shape, problem)], base[1])
        if problem.noise(changed) == problem.noise(model):
            return one
        columns = _columns(problem, base, one.effect, one.shape, problem.residual(model))
        return one if columns is None else replace(one, columns=columns)

    return each(look, pool)


def _bare(
    effect: Effect, entries: Sequence[Mapping[str, Any]], own: Mapping[str, float] | None
) -> tuple[Sequence[Mapping[str, Any]], Mapping[str, float]]:
    """The base without the effect itself, and without the number that it sets."""
    beside = dict(own or {})
    if effect.probe is not None and np.isnan(effect.probe.neutral):
        beside.pop(effect.probe.amplitude, None)
    return [entry for entry in entries if entry["effect"] != effect.id], beside


def _probed(effect: Effect, shape: Mapping[str, float], problem: Problem) -> dict[str, Any]:
    """The effect's entry, its amplitude a small step away from where it is not there."""
    probe = effect.probe
    assert probe is not None
    amplitude = neutral_value(probe, problem.model) + probe_step(effect, problem)
    return {"effect": effect.id, **shape, probe.amplitude: amplitude}


def orders_of(
    problem: Problem,
    base: Base,
    residual: Floats,
    left: Floats,
    effects: Collection[Effect],
) -> list[Candidate]:
    """Candidates of what repeats with the angle at the orders that stand out of ``left`` (n,).

    ``residual`` is that of the model with the entries of ``base``; ``left`` what of it is looked
    at, such as all that is faster than a discrepancy.
    """
    found = []
    for effect in effects:
        for order in _orders(problem, left):
            columns = _columns(problem, base, effect, {"order": order}, residual)
            if columns is not None:
                found.append(Candidate(effect, {"order": order}, columns))
    return found


def _columns(
    problem: Problem,
    base: Base,
    effect: Effect,
    shape: Mapping[str, float],
    residual: Floats,
) -> Floats | None:
    probe = effect.probe
    assert probe is not None
    if probe.scan == "curve":
        return hats(problem, base, effect, list(shape.values()), residual)
    step = probe_step(effect, problem)
    turns: list[dict[str, float]] = [{}]
    if probe.phase is not None:
        turns = [{probe.phase: 0.0}, {probe.phase: np.pi / 2}]
    columns = []
    for turn in turns:
        entry = {**_probed(effect, shape, problem), **turn}
        changed = problem.residual(problem.with_entries([*base[0], entry], base[1]))
        columns.append((residual - changed) / step)
    found = np.column_stack(columns)
    return found if np.all(np.isfinite(found)) and np.any(found) else None


def hats(
    problem: Problem, base: Base, effect: Effect, places: Sequence[float], residual: Floats
) -> Floats:
    """One column a knot: the curve that is one there and zero at its neighbours.

    While sliding only: at rest a place has the torque that friction holds there, whichever it is.
    """
    probe = effect.probe
    assert probe is not None
    step, columns = probe_step(effect, problem), []
    for k in range(len(places)):
        knots = [[x, step if i == k else 0.0] for i, x in enumerate(places)]
        entry = {"effect": effect.id, probe.amplitude: knots}
        changed = problem.residual(problem.with_entries([*base[0], entry], base[1]))
        columns.append(np.where(problem.sliding, (residual - changed) / step, 0.0))
    return np.column_stack(columns)


def _shapes(effect: Effect, problem: Problem, residual: Floats) -> Sequence[Mapping[str, float]]:
    probe = effect.probe
    assert probe is not None
    if probe.scan == "order":
        return [{"order": order} for order in _orders(problem, residual)]
    if probe.scan == "middle_rad":
        return [_middle(problem)]
    if probe.scan in ("centre_m", "position_m", "curve"):
        return _places(probe.scan, problem)
    return shapes_of(effect, problem)


def shapes_of(effect: Effect, problem: Problem) -> Sequence[Mapping[str, float]]:
    """The shapes that an effect's file gives, for a machine of this size."""
    probe = effect.probe
    assert probe is not None
    of = {one.name: problem.size.of(one, effect) for one in effect.parameters}
    return [{name: of[name] * value for name, value in shape.items()} for shape in probe.shapes]


def _middle(problem: Problem) -> Mapping[str, float]:
    """Where a spring is relaxed: at zero, or, where no recording comes by there, to be fitted.

    An angle that is counted from a place beyond the travel says nothing of where the middle is.
    """
    ends = [
        end
        for one in problem.recordings
        for end in np.percentile(one.motion(problem.model).angle_rad, [0, 100]).tolist()
    ]
    low, high = min(ends), max(ends)
    return {} if low <= 0.0 <= high else {"middle_rad": 0.5 * (low + high)}


def _places(scan: str, problem: Problem) -> Sequence[Mapping[str, float]]:
    """Shapes over the rack positions that were visited (m): bumps, stops, or a curve's knots."""
    low, high = problem.visited_m
    span, size = high - low, problem.size.place
    if span < 1e-3 * size:
        return []
    if scan == "position_m":
        # by place, not by visits: a rig that leans on its stop is mostly beyond where it begins
        near, far = problem.farthest_m, problem.extreme_m
        places = [*(near * np.array((0.6, 0.7, 0.8, 0.9, 0.97))), near, 0.6 * near + 0.4 * far]
        return [{"position_m": float(np.clip(place, 0.001 * size, 0.2 * size))} for place in places]
    if scan == "curve":
        return [{f"x{k}": float(x) for k, x in enumerate(np.linspace(low, high, _KNOTS))}]
    return [
        {"centre_m": float(centre), "width_m": float(width * span)}
        for width in (0.08, 0.25)
        for centre in np.linspace(low + 0.08 * span, high - 0.08 * span, 8)
    ]


def _orders(problem: Problem, residual: Floats) -> list[float]:
    """Orders per rotor turn at which the residual repeats: peaks of an angle-domain periodogram.

    Only samples count at which the order's frequency passes the filter.
    """
    angle, speed = [], []
    for recording in problem.recordings:
        motion = recording.motion(problem.model)
        at = np.interp(recording.thin_time_s, recording.time_s, np.arange(len(recording.time_s)))
        index = at.astype(int)
        angle.append(motion.angle_rad[index])
        speed.append(np.abs(motion.speed_rad_s[index]))
    use = problem.sliding
    turned = problem.size.angle
    phi, omega = np.concatenate(angle)[use] / turned, np.concatenate(speed)[use] / turned
    return [order / turned for order in _clear_orders(residual[use], phi, omega)]


def _clear_orders(left: Floats, phi: Floats, omega: Floats) -> list[float]:
    """The strongest orders of what is ``left`` over the angle (rad), at speeds (rad/s).

    Each is taken out before the next is looked for, or the skirts of a strong one hide the others.
    """
    left = left - np.mean(left)
    found: list[float] = []
    while len(found) < _MOST_ORDERS:
        power = _periodogram(left, phi, omega)
        for known in found:
            power[np.abs(_ORDERS - known) <= _APART] = 0.0
        if not np.any(power):
            break
        order = float(_ORDERS[np.argmax(power)])
        inside = omega * order / (2 * np.pi) < _FILTER_HZ
        near = np.clip(order + _FINE, _ORDERS[0], _ORDERS[-1])
        order = float(near[np.argmax([_power(left[inside], one * phi[inside]) for one in near])])
        found.append(order)
        waves = np.column_stack([np.cos(order * phi), np.sin(order * phi)]) * inside[:, None]
        left = left - waves @ np.linalg.lstsq(waves, left, rcond=None)[0]
    return found


def _power(left: Floats, turned: Floats) -> float:
    return float(np.abs(np.dot(np.exp(-1j * turned), left)))


def _periodogram(left: Floats, phi: Floats, omega: Floats) -> Floats:
    """Power at each of _ORDERS of what is ``left`` over the angle (rad), at speeds (rad/s)."""
    power = np.zeros(len(_ORDERS))
    parts = np.array_split(np.arange(len(_ORDERS)), _PARTS)
    each(lambda one: _powers(left, phi, omega, _ORDERS, one[0], one[-1] + 1, power), parts)
    return power


@njit
def _powers(
    left: Floats,
    phi: Floats,
    omega: Floats,
    orders: Floats,
    first: int,
    last: int,
    power: Floats,
) -> None:
    """Orders ``first`` to ``last`` of :func:`_periodogram`; each wave is the one before, turned."""
    wave = np.exp(-1j * orders[first] * phi)
    turn = np.exp(-1j * (orders[1] - orders[0]) * phi)
    for k in range(first, last):
        n, total = 0, 0.0
        waves, found = 0j, 0j
        for i in range(len(left)):
            if omega[i] * orders[k] / (2 * np.pi) < _FILTER_HZ:
                n += 1
                total += left[i]
                waves += wave[i]
                found += wave[i] * left[i]
            wave[i] *= turn[i]
        if n >= _FEWEST:
            found -= waves * (total / n)
            power[k] = (found.real**2 + found.imag**2) / n
