"""Every effect's regressor: the sensitivity of the simulated torque balance to it."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import STIFFNESS
from eps_hil.diagnosis.balance.problem import TERM, Problem
from eps_hil.diagnosis.data.prepare import CUTOFF_HZ
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.physics.effects.added import MOST_TERMS
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Effect, Parameter, Probe
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_FIRST, _LAST, _BETWEEN = 0.5, 100.0, 0.05
"""Orders per turn, and how far those that are tried are apart at most; a motor of 12 slots and 10
poles cogs 60 times."""
_OVER = 2.0
"""Times what was turned: two orders that are a whole period apart over it are told apart."""
_PART = 1.1
_PARTS = int(np.ceil(np.log(_LAST / _FIRST) / np.log(_PART)))
"""Of the periodogram: from one to the next the filter passes about as much."""
_BINS = 8
"""In a period of the highest order."""
_FINE = np.linspace(-1.0, 1.0, 21)
_MOST_ORDERS = 6
_FEWEST = 60.0
"""Samples that an order has to be seen in, by what the filter passes of it."""
_APART = 0.3
"""Orders that are nearer are one."""
_HEARD_HZ = 50.0
"""A ripple that is quicker is all but lost in the balance's low-pass: 2 % of its energy."""
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

    A sample counts by what the filter passes of the order's frequency there.
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
    if len(left) == 0:
        return []
    left, phi = left - np.mean(left), phi - np.min(phi)
    round_rad = max(_OVER * float(np.max(phi)), 2 * np.pi / _BETWEEN)
    between = 2 * np.pi / round_rad
    orders = np.arange(0.0, _LAST + between, between)
    parts = [*_parts(phi, omega, orders, round_rad)]
    found: list[float] = []
    while len(found) < _MOST_ORDERS:
        power = np.zeros(len(orders))
        for part in parts:
            power[part.low : part.high] = part.power(left)
        for known in found:
            power[np.abs(orders - known) <= _APART] = 0.0
        if not np.any(power):
            break
        order = float(np.clip(orders[np.argmax(power)], _FIRST, _LAST))
        heard = _heard(omega, order)
        inside = heard > 0.0
        weighed, turned = heard[inside] * left[inside], phi[inside]
        near = np.clip(order + _FINE * between, _FIRST, _LAST)
        order = float(near[np.argmax([_power(weighed, one * turned) for one in near])])
        found.append(order)
        waves = np.column_stack([np.cos(order * phi), np.sin(order * phi)]) * heard[:, None]
        left = left - waves @ np.linalg.lstsq(waves, left, rcond=None)[0]
    return found


def _power(left: Floats, turned: Floats) -> float:
    return float(np.abs(np.dot(np.exp(-1j * turned), left)))


def _heard(omega: Floats, order: float) -> Floats:
    """What the balance's low-pass leaves of a ripple of this order at speeds (rad/s), (n,)."""
    hz = omega * (order / (2 * np.pi))
    return np.where(hz < _HEARD_HZ, 1.0 / (1.0 + (hz / CUTOFF_HZ) ** 8), 0.0)


@dataclass(frozen=True)
class _Part:
    """A part of a periodogram over the angle: the orders ``low`` to ``high`` of all that are tried.

    ``inside``: the samples that the filter passes something of there; ``heard`` how much,
    ``place`` their bins over the angle, ``of_one`` the spectrum of a constant.
    """

    low: int
    high: int
    inside: Indices
    heard: Floats
    place: Indices
    bins: int
    of_one: npt.NDArray[np.complex128]

    def power(self, left: Floats) -> Floats:
        """Energy that each order takes of ``left`` beside a constant, (high - low,)."""
        seen = left[self.inside]
        found = self._spectrum(self.heard * seen) - self.of_one * np.mean(seen)
        return np.asarray(np.abs(found) ** 2 / np.sum(self.heard**2))

    def _spectrum(self, values: Floats) -> npt.NDArray[np.complex128]:
        binned = np.bincount(self.place, values, self.bins)
        return np.asarray(np.fft.rfft(binned)[self.low : self.high])


def _parts(phi: Floats, omega: Floats, orders: Floats, round_rad: float) -> Iterator[_Part]:
    """Of a periodogram over the angle (rad), at speeds (rad/s), where enough is heard.

    ``orders`` are the multiples of 2π/``round_rad``, which is more than was turned.
    """
    edges = np.append(_FIRST * _PART ** np.arange(_PARTS), np.inf)
    edges[0] -= 0.5 * orders[1]  # the nearest to the first is one of them
    for low, high in pairwise(np.searchsorted(orders, edges).tolist()):
        if high <= low:
            continue
        heard = _heard(omega, float(orders[(low + high) // 2]))
        inside = np.flatnonzero(heard)
        heard = heard[inside]
        if np.sum(heard**2) < _FEWEST:
            return
        bins = 1 << int(np.ceil(np.log2(_BINS * high)))
        place = (phi[inside] * (bins / round_rad)).astype(int)
        of_one = np.fft.rfft(np.bincount(place, heard, bins))[low:high]
        yield _Part(low, high, inside, heard, place, bins, np.asarray(of_one))
