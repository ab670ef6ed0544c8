"""A load cell or a torque sensor that is later than the model file says, which no effect names.

A signal that is late against all others looks like all others being early: the torque balance then
names a late motor torque, an early speed sensor, or nothing. Where such names were taken, or much
was left, one number for the one signal is tried in the place of them all.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eps_hil.diagnosis.baseline import ALL, HOLD
from eps_hil.diagnosis.fit import Fit, fit
from eps_hil.diagnosis.leftover import LARGE_EXCESS
from eps_hil.diagnosis.numbers import SPANNED
from eps_hil.diagnosis.problem import Problem
from eps_hil.diagnosis.scoring import FINAL_SHARE, refitted, threshold
from eps_hil.diagnosis.select import Selection
from eps_hil.physics.model import Model

CHANNELS = {"rack_force_n": "rack_force", "torque_sensor_nm": "torque_sensor"}
"""Signals without a delay effect of their own, and their entries in the model's ``delays_s``."""
LEAST_S = 1e-3
"""Less is how signals are sampled and filtered."""
MOST_S = 0.1
_TIMING = (HOLD, "speed_sensor_delay")
_LEAST_PART = 0.5
"""Of what a refit leaves over that the one delay has to explain."""
_RESOLUTION_S = 1e-4
_ROUNDS = 5


@dataclass(frozen=True)
class LateChannel:
    """A signal, how much later it is than the model file says (s), and what that explains."""

    signal: str
    late_s: float
    share: float
    low: float
    high: float

    def put_right(self, model: Model) -> Model:
        """The model with that signal's true delay."""
        return _late(model, self.signal, self.late_s)

    def finding(self, model: Model) -> dict[str, Any]:
        """The JSON entry (CONTRACT 7), beside the model file's ``model``."""
        key, delay_s = CHANNELS[self.signal], self.put_right(model).delays_s.of(self.signal)
        way = "later" if self.late_s > 0 else "earlier"
        return {
            "effect": "unknown",
            "kind": "instrument",
            "confidence": 0.95,
            "equation": "",
            "summary": f"{self.signal} is reported {1e3 * abs(self.late_s):.3g} ms {way} than the "
            f"model file says: delays_s.{key} of {delay_s:.3g} s explains {100 * self.share:.0f} % "
            "of the mismatch. No effect of the catalogue stands for that.",
            "parameters": {},
            "where": [
                {
                    "signal": self.signal,
                    "from": self.low,
                    "to": self.high,
                    "share_of_excess": self.share,
                }
            ],
            "curve": [],
            "confusable_with": [],
            "next_experiment": "",
        }


def late_channel(
    problem: Problem, selection: Selection, measured: Collection[str]
) -> LateChannel | None:
    """The signal whose delay alone does as well as all delays that were named; None if none does.

    And it has to explain most of what the model's own numbers, refitted, leave over. ``measured``:
    the signals that were recorded.
    """
    found = selection.searched
    timing = [entry for entry in found.entries if entry["effect"] in _TIMING]
    excess = float(np.mean(found.residual[problem.sliding] ** 2)) - 1.0
    if not timing and excess < LARGE_EXCESS:
        return None
    structures = [
        entry
        for entry in found.entries
        if entry["effect"] not in _TIMING and entry["effect"] not in SPANNED
    ]
    own = {**ALL, **problem.tied}
    bare = fit(problem, structures, own=own)
    named = fit(problem, [*structures, *timing], own=bare.own) if timing else bare
    over = bare.cost - float(len(bare.residual))
    best: tuple[float, LateChannel] | None = None
    for signal in sorted(CHANNELS.keys() & set(measured)):
        late_s, one = _followed(problem, bare, structures, signal)
        if abs(late_s) < LEAST_S:
            continue
        gain = bare.cost - one.cost
        as_good = one.cost < named.cost + threshold(problem, named.residual, FINAL_SHARE)
        if as_good and gain > _LEAST_PART * over and (best is None or one.cost < best[0]):
            seen = np.concatenate([r.raw[signal] for r in problem.recordings])
            low, high = np.percentile(seen, [2, 98])
            share = min(gain / over, 1.0)
            best = one.cost, LateChannel(signal, late_s, share, float(low), float(high))
    return None if best is None else best[1]


def _followed(
    problem: Problem, bare: Fit, structures: Sequence[Mapping[str, Any]], signal: str
) -> tuple[float, Fit]:
    """How late (s) the signal is, and the fit with that.

    The numbers that the wrong delay bent come back while it is found, so it takes a few rounds.
    """
    late_s, here, one = 0.0, problem, bare
    for _ in range(_ROUNDS):
        step_s = _best_delay(here, one, signal)
        late_s += step_s
        here = replace(problem, model=_late(problem.model, signal, late_s))
        here.knee = problem.knee
        one = fit(here, structures, own=one.own)
        if abs(step_s) < _RESOLUTION_S or abs(late_s) < LEAST_S:
            break
    return late_s, one


def with_late(content: Mapping[str, Any], finding: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON (CONTRACT 7) with this finding beside the others."""
    named = any(one["effect"] != "unknown" for one in content["findings"])
    verdict = "partly_explained" if named else "unknown_effect"
    return {**content, "verdict": verdict, "findings": [*content["findings"], dict(finding)]}


def _best_delay(problem: Problem, bare: Fit, signal: str) -> float:
    """By how much later (s) the signal fits best, the model's own numbers moved along linearly."""
    from scipy.optimize import minimize_scalar

    model = problem.with_entries(bare.entries, bare.own)
    least = -model.delays_s.of(signal)

    def cost(late_s: float) -> float:
        residual = problem.residual(_late(model, signal, late_s))
        return problem.cost(refitted(residual, bare.jacobian))

    grid = np.linspace(least, MOST_S, 26)
    costs = [cost(float(one)) for one in grid]
    k = int(np.argmin(costs))
    ends = float(grid[max(k - 1, 0)]), float(grid[min(k + 1, len(grid) - 1)])
    found = minimize_scalar(cost, bounds=ends, method="bounded", options={"xatol": _RESOLUTION_S})
    return float(found.x)


def _late(model: Model, signal: str, late_s: float) -> Model:
    key = CHANNELS[signal]
    moved = {key: max(getattr(model.delays_s, key) + late_s, 0.0)}
    return replace(model, delays_s=replace(model.delays_s, **moved))
