"""The next experiment: which rig test tells a finding from what else it could be.

Each test of a menu is simulated. On its motion the finding, as fitted, changes the torque balance
in one way; its rival, in whatever shape and strength and with every number of the model moved
along, can copy a part of that. What cannot be copied, in variances of the sensors' noise and per
minute of test, is the separation. So is what a sensor reads with nothing on it, where one of the
two is that sensor's constant error. The menu comes from outside: this package knows no rig.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import ALL, HOLD, turned
from eps_hil.diagnosis.balance.probes import probe_step, shapes_of
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.direct.zero_reading import told_apart
from eps_hil.diagnosis.mismatch.locate import coordinates
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Effect
from eps_hil.physics.model import Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

CLEAR = 60.0
"""Noise variances by which one name has to beat another (``finding.RIVAL_GAIN``)."""
_KNOB_STEP = 0.05
_PLACES = 6
_MOSTLY = 0.05
"""A finding of which the model's own numbers leave less than this is one of them."""


@dataclass(frozen=True)
class Advice:
    """What a test of the menu tells: noise variances a minute, and minutes until it is clear."""

    manoeuvre: str
    separation_per_min: float
    seconds: float

    @property
    def minutes(self) -> float:
        """Until one name beats the other, but the test whole; infinite where it never does."""
        if self.separation_per_min <= 0:
            return np.inf
        return max(CLEAR / self.separation_per_min, self.seconds / 60.0)

    def content(self) -> dict[str, Any]:
        """For the JSON."""
        return {
            "manoeuvre": self.manoeuvre,
            "separation_per_min": float(f"{self.separation_per_min:.4g}"),
            "minutes": float(f"{self.minutes:.3g}") if np.isfinite(self.minutes) else None,
        }


def advise(
    model: Model,
    entry: Mapping[str, Any],
    rivals: Sequence[str],
    menu: Mapping[str, Mapping[str, Series]],
    settled: Collection[str] = (),
) -> list[Advice]:
    """Tests of ``menu`` (name -> its simulated recording), that which tells most first.

    ``model`` is without ``entry``, the finding as fitted; a test is worth what it tells of the
    rival that copies the finding best. ``settled``: constant errors of sensors that were read with
    nothing on them already, and that it would not help to read again.
    """
    found = []
    model = replace(model, effects=_others(model, entry))
    for name, series in menu.items():
        recording = prepare(name, series)
        problem = Problem([recording], model)
        seconds = float(problem.recordings[0].time_s[-1] - problem.recordings[0].time_s[0])
        least = min(
            separation(problem, entry, rival) + told_apart(recording, model, entry, rival, settled)
            for rival in rivals
        )
        found.append(Advice(name, 60.0 * least / seconds, seconds))
    return sorted(found, key=lambda one: -one.separation_per_min)


def separation(problem: Problem, entry: Mapping[str, Any], rival: str) -> float:
    """What of ``entry`` on this motion neither ``rival`` nor the model's own numbers can copy."""
    use = problem.sliding
    base = problem.residual(problem.model)
    target = (problem.residual(problem.with_entries([entry])) - base)[use]
    own = own_columns(problem, base)[use]
    if unexplained(target, own) < _MOSTLY * float(target @ target):
        own = own[:, [list(ALL).index(HOLD)]]  # the finding is one of these numbers
    effect = catalogue()[rival]
    left = [
        unexplained(target, np.column_stack([own, columns[use]]))
        for columns in copies(problem, effect, base)
    ]
    return min(left, default=unexplained(target, own))


def _others(model: Model, entry: Mapping[str, Any]) -> tuple[Mapping[str, Any], ...]:
    return tuple(one for one in model.effects if one["effect"] != entry["effect"])


def own_columns(problem: Problem, base: Floats) -> Floats:
    """Sensitivities (n, k) to the model's own numbers; ``base`` is its residual."""
    columns = []
    for name in ALL:
        moved = turned(problem.model, {name: _KNOB_STEP}, problem.size)
        columns.append((problem.residual(moved) - base) / _KNOB_STEP)
    return np.column_stack(columns)


def copies(problem: Problem, effect: Effect, base: Floats) -> list[Floats]:
    """The rival's sensitivities in each of its shapes, each (n, 1 or 2)."""
    probe = effect.probe
    if probe is None:
        return []
    neutral = probe.neutral
    if np.isnan(neutral):
        neutral = float(getattr(problem.model.friction, probe.amplitude))
    turns: list[dict[str, float]] = [{}]
    if probe.phase is not None:
        turns = [{probe.phase: 0.0}, {probe.phase: np.pi / 2}]
    found, step = [], probe_step(effect, problem)
    for shape in _shapes(problem, effect):
        columns = []
        for turn in turns:
            entry = {"effect": effect.id, **shape, probe.amplitude: neutral + step, **turn}
            changed = problem.residual(problem.with_entries([entry]))
            columns.append((changed - base) / step)
        found.append(np.column_stack(columns))
    return found


def _shapes(problem: Problem, effect: Effect) -> Sequence[Mapping[str, Any]]:
    probe = effect.probe
    assert probe is not None
    if probe.scan in ("", "middle_rad"):
        return shapes_of(effect, problem)
    position = coordinates(problem)["rack_position_m"]
    low, high = (float(v) for v in np.percentile(position, [3, 97]))
    if probe.scan == "order":
        turned_by = problem.size.angle
        return [{"order": n / turned_by} for n in (1.0, 2.0, 4.0, 6.0, 8.0, 12.0, 24.0)]
    if probe.scan == "position_m":
        near = 1e-3 * problem.size.place
        return [{"position_m": max(near, part * max(-low, high))} for part in (0.7, 0.9)]
    if probe.scan == "centre_m":
        width = max(5e-4 * problem.size.place, 0.15 * (high - low))
        centres = np.linspace(low, high, _PLACES)
        return [{"centre_m": float(centre), "width_m": width} for centre in centres]
    return []


def unexplained(target: Floats, columns: Floats) -> float:
    """Sum of squares of ``target`` that the columns leave (units of the noise)."""
    size = np.sqrt(np.sum(columns**2, axis=0))
    columns = columns[:, size > 0] / size[size > 0]
    solved = np.linalg.lstsq(columns, target, rcond=1e-7)[0]
    return float(np.sum((target - columns @ solved) ** 2))
