"""All parameters of the chosen effects together: bounded least squares on the torque balance."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import HOLD, SIDES, is_free, knob_of
from eps_hil.diagnosis.balance.probes import bounds, neutral_value, probe_step
from eps_hil.diagnosis.balance.problem import Problem, huber, knee, term_of
from eps_hil.diagnosis.balance.spread import Integers, half_widths, less_noise
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Effect

Floats = npt.NDArray[np.float64]

_FIXED = ("belt_ratio", "pole_pairs", "harmonic", "curve")
"""Not moved by the joint fit: given by the model file, or solved for in one step (a curve)."""


BRISTLE, _LOST_PATHS = "presliding_hysteresis", 1.25
"""A bristle stiffer by no more than so many lost paths is what the angle's noise makes of it."""
_PLACE = ("centre_m", "width_m")
FARTHEST_OWN = 8.0
"""Usual errors beyond which the model's own numbers are not moved: it is another rig then."""
_TRUSTED = 0.7
"""Share of the promised gain below which sensitivities are out of date."""
_NO_PART = 1e-9
"""Of a small change: an amplitude that is nothing."""
_DELAY, _OWN = "delay_s", -1
"""A delay's name, and the place of the model's own numbers among entries."""
_NEGLIGIBLE = 0.5
"""A fit ends where its next step would gain less than this part of a noise variance."""


@dataclass(frozen=True)
class Fit:
    """Fitted entries, weighted residual (n,), and the names of the numbers that were fitted.

    ``own``: how far the model's own numbers were moved beside the entries (empty: not at all).
    ``jacobian`` has the columns of ``own`` first, then those of ``names``.
    """

    entries: tuple[dict[str, Any], ...]
    residual: Floats
    names: tuple[tuple[int, str], ...]
    jacobian: Floats
    own: Mapping[str, float] = field(default_factory=dict)
    cost: float = 0.0
    """Huber's loss, twice, at the problem's knee, and the price of ``own`` (its prior)."""
    knee: float = np.inf
    groups: tuple[Integers, ...] = ()
    """Blocks and stretches (n,) within which residuals are correlated."""
    told_half_width: Mapping[tuple[int, str], float] | None = None
    """Half widths from a fit that was whitened, where this residual is not."""
    noise: Mapping[tuple[int, str], float] = field(default_factory=dict)
    """Energy that noise has in the sensitivity to a delay, by place and name."""

    @cached_property
    def half_width(self) -> Mapping[tuple[int, str], float]:
        """Half widths of the 95 % intervals of the fitted numbers, by place and parameter name."""
        if self.told_half_width is not None or not self.names:
            return self.told_half_width or {}
        weight = np.sqrt(huber(self.residual, self.knee))
        first, jacobian = len(self.own), self.jacobian * weight[:, None]
        noise = _by_column(self.noise, self.own, self.names)
        wide = half_widths(jacobian, self.residual * weight, self.groups, first, noise)[first:]
        return dict(zip(self.names, (float(one) for one in wide), strict=True))

    def slopes(self) -> dict[tuple[str, str], Floats]:
        """Columns of the Jacobian by (term, parameter)."""
        first = len(self.own)
        return {
            (term_of(self.entries[k]), name): self.jacobian[:, first + i]
            for i, (k, name) in enumerate(self.names)
        }


_NEARER = (0.5, 0.25, 0.0)
"""Of how far the model's own numbers were moved: where a fit begins that cannot begin there."""


def fit(
    problem: Problem,
    entries: Sequence[Mapping[str, Any]],
    rounds: int = 10,
    own: Mapping[str, float] | None = None,
    like: Fit | None = None,
) -> Fit:
    """Levenberg-Marquardt within bounds from the given entries; Huber weights against outliers.

    ``own`` names the model's own numbers that are fitted too, and where from (see baseline).
    Sensitivities are taken from ``like``, a fit nearby, where it has them, and anew only where a
    step gains less than they promised: most of the model is nearly linear.
    """
    names = tuple(
        (k, p.name)
        for k, entry in enumerate(entries)
        for p in catalogue()[entry["effect"]].parameters
        if p.name in entry and p.name not in _FIXED
    )
    work = [dict(entry) for entry in entries]
    knobs, residual = _start(problem, work, own or {})
    groups = problem.block, problem.stretch
    if not np.isfinite(residual).all():  # no friction is left: nothing can be fitted from there
        nothing = np.zeros((len(residual), len(knobs.values) + len(names)))
        at = problem.knee or np.inf
        return Fit(tuple(work), residual, names, nothing, knobs.values, np.inf, at, groups)
    at = problem.knee = problem.knee or knee(residual)
    cost = problem.cost(residual) + knobs.price
    jacobian = np.hstack([knobs.columns, np.zeros((len(residual), len(names)))])
    damping = 1e-3
    known = {} if like is None else like.slopes()
    fresh = not known
    noise: dict[tuple[int, str], float] = {}
    if not rounds:
        slopes, noise = _jacobian(problem, work, names, residual, knobs.values)
        jacobian = np.hstack([knobs.columns_beside(work, names, residual, noise), slopes])
    for _ in range(rounds if jacobian.shape[1] else 0):
        wanted = [n for n in names if _stale(n, work, known) or fresh]
        slopes, told = _jacobian(problem, work, wanted, residual, knobs.values)
        noise |= told
        known |= {(term_of(work[k]), n): slopes[:, i] for i, (k, n) in enumerate(wanted)}
        found = [known[term_of(work[k]), n] for k, n in names]
        jacobian = np.column_stack([knobs.columns_beside(work, names, residual, noise), *found])
        fresh_now, fresh = len(wanted) == len(names), False
        normal, slope = knobs.with_prior(*_normal(jacobian, residual, at))
        normal = less_noise(normal, _by_column(noise, knobs.names, names))
        size = np.sqrt(np.maximum(np.diag(normal), 1e-30))
        before = cost
        for _attempt in range(5):
            scaled = normal / np.outer(size, size) + damping * np.eye(len(size))
            step = -np.linalg.lstsq(scaled, slope / size, rcond=None)[0] / size
            promised = -float(slope @ step)
            if promised < _NEGLIGIBLE:
                break
            moved = knobs.moved(step[: len(knobs.names)])
            trial = _moved(problem, work, names, step[len(knobs.names) :])
            changed = problem.residual(problem.with_entries(trial, moved.values))
            lower = problem.cost(changed) + moved.price
            if lower < cost:
                work, residual, knobs, cost = trial, changed, moved, lower
                damping = max(damping / 10, 1e-9)
                break
            damping *= 10
            if not fresh_now:
                break
        if before - cost < _NEGLIGIBLE and (fresh_now or promised < _NEGLIGIBLE):
            break
        fresh = before - cost < _TRUSTED * promised
    return Fit(tuple(work), residual, names, jacobian, knobs.values, cost, at, groups, noise=noise)


def _start(
    problem: Problem, entries: Sequence[Mapping[str, Any]], own: Mapping[str, float]
) -> tuple["_Knobs", Floats]:
    """The model's own numbers as near to ``own`` as there is a residual, and that."""
    knobs = _Knobs(problem, own)
    residual = problem.residual(problem.with_entries(entries, knobs.values))
    for share in _NEARER:
        if np.isfinite(residual).all():
            break
        # without an effect, what the model's own numbers had come to beside it may be no friction
        knobs = _Knobs(problem, {name: share * value for name, value in own.items()})
        residual = problem.residual(problem.with_entries(entries, knobs.values))
    return knobs, residual


def _normal(jacobian: Floats, residual: Floats, at: float) -> tuple[Floats, Floats]:
    """Normal matrix and slope under Huber's weights."""
    weighted = jacobian * huber(residual, at)[:, None]
    return weighted.T @ jacobian, weighted.T @ residual


def _stale(
    name: tuple[int, str],
    entries: Sequence[Mapping[str, Any]],
    known: Mapping[tuple[str, str], Floats],
) -> bool:
    """Whether a sensitivity has to be taken anew: that to a delay is of the noise where it is."""
    return name[1] == _DELAY or (term_of(entries[name[0]]), name[1]) not in known


class _Knobs:
    """The model's own numbers during a fit: values, sensitivities and the price of the prior."""

    def __init__(self, problem: Problem, values: Mapping[str, float] | None) -> None:
        self.problem = problem
        self.values = dict(values or {})
        self.names = list(self.values)
        self.vector = np.array(list(self.values.values()))
        self.price = float(self.vector @ self.vector)

    @property
    def columns(self) -> Floats:
        if not self.names:
            return np.zeros((len(self.problem.scale), 0))
        return np.column_stack([own_column(self.problem, name) for name in self.names])

    def columns_beside(
        self,
        entries: Sequence[Mapping[str, Any]],
        names: Sequence[tuple[int, str]],
        residual: Floats,
        noise: dict[tuple[int, str], float],
    ) -> Floats:
        """The same beside ``entries``; adds to ``noise`` what it has in the motor torque's hold.

        That is a delay too, and moves far where another one is fitted: then it is taken anew.
        """
        columns = self.columns
        if HOLD not in self.names or all(name != _DELAY for _, name in names):
            return columns
        step, now = knob_of(HOLD).step, self.values[HOLD]
        late, early = (
            self.problem.residual(self.problem.with_entries(entries, {**self.values, HOLD: at}))
            for at in (now + step, now - step)
        )
        weight = huber(residual, self.problem.knee)
        noise[_OWN, HOLD] = _noise(late, residual, early, weight) / step**2
        columns[:, self.names.index(HOLD)] = (late - early) / (2.0 * step)
        return columns

    def with_prior(self, normal: Floats, slope: Floats) -> tuple[Floats, Floats]:
        """Normal equations with what the own numbers, which come first, pay for being moved."""
        count = len(self.names)
        normal[:count, :count] += np.eye(count)
        slope[:count] += self.vector
        return normal, slope

    def moved(self, step: Floats) -> "_Knobs":
        turned = np.clip(self.vector + step, -FARTHEST_OWN, FARTHEST_OWN)
        values = dict(zip(self.names, turned.tolist(), strict=True))
        return _Knobs(self.problem, values)


def own_column(problem: Problem, name: str) -> Floats:
    """Sensitivity of the weighted residual to one of the model's own numbers, (n,).

    Taken at ``problem.at`` (the refitted numbers, once they are known).
    """
    if name not in problem.columns:
        knob = knob_of(name)
        at = problem.at.get(name, 0.0)
        up, down = (
            problem.residual(problem.with_entries([], {**problem.at, name: at + step}))
            for step in (knob.step, -knob.step)
        )
        problem.columns[name] = (up - down) / (2 * knob.step)
    return problem.columns[name]


def _jacobian(
    problem: Problem,
    entries: Sequence[Mapping[str, Any]],
    names: Sequence[tuple[int, str]],
    residual: Floats,
    own: Mapping[str, float],
) -> tuple[Floats, dict[tuple[int, str], float]]:
    """(sensitivities (n, names), energy that noise has in those to delays)."""
    columns, noise = [np.zeros((len(residual), 0))], {}
    for k, name in names:
        effect = catalogue()[entries[k]["effect"]]
        (parameter,) = (p for p in effect.parameters if p.name == name)
        value = float(entries[k][name])
        low, high = problem.size.bounds(parameter, effect)
        size = step_of(effect, name, value, problem)
        if name in _PLACE:  # wherever a place counts from, it is as large as its width
            size = 0.01 * float(entries[k]["width_m"])
        step = size if value + size <= high else -size
        moved = problem.residual(problem.with_entries(_with(entries, k, name, step), own))
        if name == _DELAY and low <= value - step <= high:
            other = problem.residual(problem.with_entries(_with(entries, k, name, -step), own))
            weight = huber(residual, problem.knee)
            noise[k, name] = _noise(moved, residual, other, weight) / step**2
            columns.append(((moved - other) / (2.0 * step))[:, None])
        else:
            columns.append(((moved - residual) / step)[:, None])
    return np.hstack(columns), noise


def _noise(later: Floats, now: Floats, earlier: Floats, weight: Floats) -> float:
    """Energy that noise has in the sensitivity to a delay, by residuals a step to either side.

    The square of the sensitivity less the curvature of the loss: noise is as large at any delay.
    With it in the normal matrix steps would be a part of what they have to be, promise less than
    there is, and end on the way. (A difference to one side alone, or sensitivities at another
    delay, would go with the noise of the residual and pull towards where they were taken.)
    """
    squares = float(np.sum(weight * (later - earlier) ** 2)) / 4.0
    curvature = float(np.sum(weight * (later**2 + earlier**2 - 2.0 * now**2))) / 2.0
    return float(np.clip(squares - curvature, 0.0, squares))


def _by_column(
    noise: Mapping[tuple[int, str], float], own: Collection[str], names: Sequence[tuple[int, str]]
) -> Floats:
    """Of each column of a Jacobian; the model's ``own`` numbers come first."""
    return np.array([noise.get(one, 0.0) for one in (*((_OWN, name) for name in own), *names)])


def _with(
    entries: Sequence[Mapping[str, Any]], k: int, name: str, by: float
) -> list[dict[str, Any]]:
    changed = [dict(entry) for entry in entries]
    changed[k][name] += by
    return changed


def step_of(effect: Effect, name: str, value: float, problem: Problem) -> float:
    """A change of a parameter that is small, and large against rounding."""
    if effect.probe is not None and name == effect.probe.amplitude:
        return probe_step(effect, problem)
    (parameter,) = (p for p in effect.parameters if p.name == name)
    span = parameter.upper - parameter.lower
    return max(abs(value) * 0.01, min(span * 1e-4, 0.01) * problem.size.of(parameter, effect))


def _moved(
    problem: Problem,
    entries: Sequence[Mapping[str, Any]],
    names: Sequence[tuple[int, str]],
    step: Floats,
) -> list[dict[str, Any]]:
    moved = [dict(entry) for entry in entries]
    for (k, name), change in zip(names, step, strict=True):
        effect = catalogue()[moved[k]["effect"]]
        (parameter,) = (p for p in effect.parameters if p.name == name)
        value = moved[k][name] + change
        if effect.probe is not None and name == effect.probe.phase:
            value = (value + np.pi) % (2 * np.pi) - np.pi
        elif parameter.lower > 0:  # a scale: no more than a factor of three at once
            value = np.clip(value, moved[k][name] / 3, moved[k][name] * 3)
        low, high = bounds(effect, parameter, problem)
        moved[k][name] = float(np.clip(value, low, high))
    return moved


def own_without(found: Fit, places: Collection[int]) -> dict[str, float]:
    """The model's own numbers without those that only went with the entries at ``places``."""
    if is_free(found.own):  # the free baseline goes with no name
        return dict(found.own)
    gone = {side for k in places for side in SIDES.get(str(found.entries[k]["effect"]), ())}
    return {name: value for name, value in found.own.items() if name not in gone}


def ablated(problem: Problem, found: Fit, k: int, rounds: int = 6) -> Fit:
    """The fit without entry ``k``, the others refitted.

    Several steps of a search ask this of the same fit: those of the last one are kept.
    """
    of, at, kept = problem.ablations
    if of is not found or at != problem.knee:
        kept = {}
        problem.ablations = found, problem.knee, kept
    if (k, rounds) not in kept:
        others = [e for i, e in enumerate(found.entries) if i != k]
        kept[k, rounds] = fit(problem, others, rounds, own_without(found, (k,)), found)
    told: Fit = kept[k, rounds]
    return told


def deviation(entry: Mapping[str, Any], problem: Problem) -> float:
    """How far an entry's amplitude is from where the effect is not there."""
    probe = catalogue()[entry["effect"]].probe
    assert probe is not None
    if probe.scan == "curve":
        return max(abs(torque) for _, torque in entry[probe.amplitude])
    return float(abs(entry[probe.amplitude] - neutral_value(probe, problem.model)))


def matters(entry: Mapping[str, Any], problem: Problem) -> bool:
    """Whether an entry is large enough to be a finding rather than how rigs are."""
    effect = catalogue()[entry["effect"]]
    probe = effect.probe
    assert probe is not None
    of = neutral_value(probe, problem.model) if np.isnan(probe.neutral) else 1.0
    if entry["effect"] == BRISTLE and not _beyond_lost_path(entry, problem):
        return False
    return deviation(entry, problem) > max(probe.least * of, _NO_PART * probe_step(effect, problem))


def _beyond_lost_path(entry: Mapping[str, Any], problem: Problem) -> bool:
    """Whether a bristle is stiffer by more than the path that the angle's noise hides makes it.

    What a resting rotor creeps back inside the noise is lost, so that friction seems to turn over
    a shorter way than it does: T_fs/σ0, here of the model's own sliding level. Without an angle
    nothing shows how it creeps, and no stiffness can be told.
    """
    friction = problem.model.friction
    modelled, found = friction.sigma0_nm_per_rad, float(entry["sigma0_nm_per_rad"])
    if not all("motor_angle_rad" in one.raw for one in problem.recordings):
        return False
    if found <= modelled:
        return True
    level = 0.5 * (friction.offset_pos_nm + friction.offset_neg_nm)
    shorter = level / modelled - level / found
    return shorter > _LOST_PATHS * max(one.lost_path_rad for one in problem.recordings)
