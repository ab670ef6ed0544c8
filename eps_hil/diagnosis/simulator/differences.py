"""Both directions of a difference: what a simulator has and a rig lacks, which numbers differ.

Each effect of the simulator is held against the recordings whole, by half and not at all, the
model file's own numbers free beside it. One of which the rig has (nearly) none, and without which
recordings kept from that fit are explained better, is too many. The diagnosis then starts from the
simulator without it: it needs no negative friction, and no unknown, to say so.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.attribute.scoring import LEAST_GAIN
from eps_hil.diagnosis.balance.fit import BRISTLE
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee, plain
from eps_hil.diagnosis.balance.spread import half_widths
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.diagnosis.simulator.parameters import Reduction, reduce_parameters
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model
from eps_hil.unit_words import spaced

Floats = npt.NDArray[np.float64]

_SHARES = (0.0, 0.5, 1.0)
_GONE = 0.2
"""Share of the simulator's amplitude below which the rig does not have the effect."""
_APART = 0.02
"""A number that differs by less than this part of itself is the same."""
_WEAK = 0.05
"""Share of the strongest change's significance below which another one is how reductions differ."""
NUMBERS = (
    "coulomb_level",
    "friction_asymmetry",
    "viscous_friction",
    "load_dependent_friction",
    "inertia",
)
"""Findings that say nothing but that numbers of the model file are others."""


@dataclass(frozen=True)
class Surplus:
    """An effect that the simulator has and the rig lacks; ``rig``: its amplitude there.

    Half widths of 95 % intervals: of the rig's amplitude, and of the simulator's.
    """

    entry: Mapping[str, Any]
    amplitude: str
    unit: str
    rig: float
    rig_half_width: float
    simulator_half_width: float

    @property
    def simulator(self) -> float:
        """The simulator's amplitude."""
        return float(self.entry[self.amplitude])

    @property
    def ci95(self) -> list[float]:
        """Of the simulator's amplitude."""
        return _around(self.simulator, self.simulator_half_width)

    def content(self) -> dict[str, Any]:
        """For the JSON."""
        effect = catalogue()[self.entry["effect"]]
        size = f"{self.amplitude} {self.simulator:.3g}{spaced(self.unit)}"
        rig = {"value": self.rig, "unit": self.unit, "ci95": _around(self.rig, self.rig_half_width)}
        return {
            "effect": effect.id,
            "parameters": {k: v for k, v in plain(dict(self.entry)).items() if k != "effect"},
            "ci95": {self.amplitude: self.ci95},
            "rig": {self.amplitude: rig},
            "summary": f"The simulator has {effect.name.lower()} ({size}) that the rig lacks.",
        }


@dataclass(frozen=True)
class Asked:
    """What the recordings say of the simulator's effects: too many, or the rig has it (ids)."""

    surplus: Sequence[Surplus] = ()
    had: Sequence[str] = ()


def asked(
    fitted: Sequence[Prepared],
    kept: Sequence[Prepared],
    model: Model,
    effects: Collection[Mapping[str, Any]],
    traces: Problem,
) -> Asked:
    """Which of the simulator's ``effects`` the recordings do without; ``model`` has them.

    ``traces``: the simulator's own, with the model that explains them.
    """
    found: list[Surplus] = []
    had: list[str] = []
    for entry in effects:
        now = _gone(fitted, kept, model, entry, traces)
        if isinstance(now, Surplus):
            found.append(now)
            model = without(model, [now])
        elif now is _HAD:
            had.append(str(entry["effect"]))
    return Asked(found, had)


class _Answer(Enum):
    """Of an effect that is not too many."""

    HAD = "the rig has it"
    UNDECIDED = "the hold-outs do not tell, or it has no size"


_HAD, _UNDECIDED = _Answer.HAD, _Answer.UNDECIDED


def _gone(
    fitted: Sequence[Prepared],
    kept: Sequence[Prepared],
    model: Model,
    entry: Mapping[str, Any],
    traces: Problem,
) -> Surplus | _Answer:
    """The effect, if it is too many: the model's own numbers are free beside all shares of it."""
    effect = catalogue()[entry["effect"]]
    probe = effect.probe
    if probe is None or not comparable(entry):
        return _UNDECIDED
    size = float(entry[probe.amplitude])
    tried = []
    for share in _SHARES:
        scaled = {**entry, probe.amplitude: share * size}
        effects = tuple(scaled if dict(one) == dict(entry) else one for one in model.effects)
        if not share:
            effects = tuple(one for one in model.effects if dict(one) != dict(entry))
        tried.append(reduce_parameters(Problem(fitted, replace(model, effects=effects))))
    costs = [float(np.sum(one.residual**2)) for one in tried]
    bend, slope, _ = np.polyfit(_SHARES, costs, 2)
    share = -0.5 * slope / bend if bend > 0.0 else float(_SHARES[int(np.argmin(costs))])
    judge = [Problem(kept, one.model) for one in (tried[-1], tried[0])]
    left = [one.residual(one.model) for one in judge]
    gain = [float(np.sum(clipped(one, knee(left[1])) ** 2)) for one in left]
    if costs[0] > costs[-1] or abs(share) > _GONE:
        return _HAD if share > _GONE and gain[1] - gain[0] >= LEAST_GAIN else _UNDECIDED
    if gain[0] - gain[1] < LEAST_GAIN:
        return _UNDECIDED
    unit = next(one.unit for one in effect.parameters if one.name == probe.amplitude)
    at_best = tried[0].residual + share * (tried[-1].residual - tried[0].residual)
    wide = _half_width(Problem(fitted, model), tried[-1].residual - tried[0].residual, at_best)
    bare = replace(
        traces.model,
        effects=tuple(one for one in traces.model.effects if plain(one) != plain(entry)),
    )
    of_it = traces.residual(traces.model) - reduce_parameters(replace(traces, model=bare)).residual
    its = _half_width(traces, of_it, traces.residual(traces.model))
    return Surplus(entry, probe.amplitude, unit, share * size, abs(size) * wide, abs(size) * its)


def comparable(entry: Mapping[str, Any]) -> bool:
    """Whether it can be asked how much of an effect the rig has: one size, and none of it is 0."""
    probe = catalogue()[entry["effect"]].probe
    if probe is None or probe.neutral != 0.0:
        return False
    size = entry.get(probe.amplitude)
    return isinstance(size, float) and bool(size)


def _half_width(problem: Problem, column: Floats, left: Floats) -> float:
    """Of the multiple of an effect whose residual is ``column`` once all else is fitted again."""
    return float(half_widths(column[:, None], left, (problem.block, problem.stretch))[0])


def _around(value: float, half_width: float) -> list[float]:
    return [value - half_width, value + half_width]


def without(model: Model, found: Sequence[Surplus]) -> Model:
    """The simulator's model without what is too many."""
    gone = [dict(one.entry) for one in found]
    return replace(model, effects=tuple(one for one in model.effects if dict(one) not in gone))


def numbers(
    recordings: Sequence[Prepared],
    model: Model,
    written: Model,
    findings: Sequence[Mapping[str, Any]],
    parameters: Mapping[str, Mapping[str, Any]],
) -> list[dict[str, Any]]:
    """Numbers in which rig and simulator differ: simulator's, rig's, intervals, a sentence.

    ``model``: the simulator; ``written``: the same with the ``findings`` (of the JSON). None unless
    a finding says that a number differs: what no finding rests on is not made one here.
    ``parameters``: of the simulator, those that its traces moved, with their intervals.
    """
    told = [*_of_effects(model, written, findings), *_of_bristle(model, findings)]
    if not {one["effect"] for one in findings} & set(NUMBERS):
        return told
    structure = tuple(one for one in written.effects if one["effect"] not in NUMBERS)
    reduction: Reduction = reduce_parameters(
        Problem(recordings, replace(model, effects=structure)), timing=False
    )
    pulls = [
        abs(after - before) / max(sigma, 1e-300) for _, before, after, sigma in reduction.moved
    ]
    for (one, before, after, sigma), pull in zip(reduction.moved, pulls, strict=True):
        small = abs(after - before) < _APART * max(abs(before), abs(after))
        if small or pull < _WEAK * max(pulls):
            continue
        interval = [after - 1.96 * sigma, after + 1.96 * sigma]
        its = parameters.get(one.name, {}).get("ci95")
        told.append(_number(one.name, one.unit, before, after, interval, its))
    return told


def _of_effects(
    model: Model, written: Model, findings: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Effects of which the simulator has one term and the recordings ask for one more."""
    told = []
    for name in {str(one["effect"]) for one in model.effects}:
        mine, theirs = (
            [one for one in some.effects if one["effect"] == name] for some in (model, written)
        )
        probe = catalogue()[name].probe
        if len(mine) != 1 or len(theirs) != 2 or probe is None or probe.phase is not None:
            continue
        values = [one.get(probe.amplitude) for one in theirs]
        if None not in values:
            unit = next(
                one.unit for one in catalogue()[name].parameters if one.name == probe.amplitude
            )
            before, after = (
                float(mine[0][probe.amplitude]),
                sum(float(one or 0.0) for one in values),
            )
            step = next(
                (
                    one["parameters"].get(probe.amplitude)
                    for one in findings
                    if one["effect"] == name
                ),
                None,
            )
            ends = None if step is None else step["ci95"]
            interval = None if ends is None else [before + end for end in ends]
            told.append(_number(f"{name}.{probe.amplitude}", unit, before, after, interval, None))
    return told


def _of_bristle(model: Model, findings: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """How the simulator and the rig turn round, where a finding says that they differ."""
    return [
        _number(
            f"friction.{name}",
            one["unit"],
            model.friction.sigma0_nm_per_rad,
            one["value"],
            one["ci95"],
            None,
        )
        for finding in findings
        if finding["effect"] == BRISTLE
        for name, one in finding["parameters"].items()
    ]


def _number(
    name: str,
    unit: str,
    before: float,
    after: float,
    interval: list[float] | None,
    its: list[float] | None,
) -> dict[str, Any]:
    told = "" if interval is None else f" (95 %: {interval[0]:.4g} to {interval[1]:.4g})"
    return {
        "name": name,
        "unit": unit,
        "simulator": before,
        "rig": after,
        "ci95": interval,
        "simulator_ci95": its,
        "summary": f"{name}: {before:.4g}{spaced(unit)} in the simulator, {after:.4g}{told} "
        "on the rig.",
    }
