"""What an experiment tells: squared distance between the models that are still possible.

A question is a pair of models: with an effect and without it, or with one name and with its rival.
On the motion of an experiment (or of recordings) the pair differs in the torque balance. What of
that difference the other model cannot copy by moving its own numbers, in variances of noise and
discrepancy, is D², the distance that decides how surely the answer will be read
(docs/howto-investigate.md, "How an experiment is chosen").
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import ALL, HOLD
from eps_hil.diagnosis.balance.probes import neutral_value, probe_step, shapes_of
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.direct.zero_reading import told_apart
from eps_hil.diagnosis.verdict.advise import own_columns, separation, unexplained
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Effect
from eps_hil.physics.model import Model
from eps_hil.programme.limits import Limits
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

CLEAR = 60.0
"""Noise variances by which a diagnosis tells one name from another (``verdict/finding.py``)…"""
CLEAR_SIGMA = 4.0
"""…count as so many deviations between two answers: one in 44 is then read wrongly."""
FITTED = 2.0 / 3.0
"""Of a recording; the rest judges."""
_OWN = 0.05
_ORDERS = (1.0, 4.0, 8.0, 24.0)
_PLACES, _WIDTH, _STOP = (-0.7, -0.35, 0.0, 0.35, 0.7), 0.12, 0.72
"""Of the travel: where a place of more friction may be, how wide it is, where a stop may begin."""

Shape = tuple[str, Mapping[str, Any]]
"""An effect and its parameters but for the amplitude."""


@dataclass(frozen=True)
class Sight:
    """What recordings show of each shape of each effect, for an amplitude of one."""

    seconds: float
    sliding_s: float
    rms_nm: Floats
    distance: Floats
    """D², noise variances."""


def shapes(model: Model, limits: Limits, problem: Problem) -> list[Shape]:
    """Every effect that the torque balance can show, in the shapes that are asked for."""
    found: list[Shape] = []
    for effect in catalogue().values():
        if effect.probe is None or effect.id in {one["effect"] for one in model.effects}:
            continue
        found += [(effect.id, shape) for shape in _shapes_of(effect, limits, problem)]
    return found


def _shapes_of(effect: Effect, limits: Limits, problem: Problem) -> Sequence[Mapping[str, Any]]:
    probe, travel = effect.probe, limits.rack_travel_m
    assert probe is not None
    match probe.scan:
        case "order":
            return [{"order": order / problem.size.angle} for order in _ORDERS]
        case "position_m":
            return [{"position_m": _STOP * travel}]
        case "centre_m":
            return [{"centre_m": at * travel, "width_m": _WIDTH * travel} for at in _PLACES]
        case "curve":
            return [{}]
        case _:
            return shapes_of(effect, problem)


def entries(shape: Shape, amplitude: float, model: Model, limits: Limits) -> list[dict[str, Any]]:
    """The effect of this shape and amplitude (above its neutral value); of a phase, both."""
    effect = catalogue()[shape[0]]
    probe = effect.probe
    assert probe is not None
    if probe.scan == "curve":
        places = np.linspace(-1.0, 1.0, 5) * limits.rack_travel_m
        knots = [[float(x), amplitude * (-1.0) ** k] for k, x in enumerate(places)]
        return [{"effect": effect.id, probe.amplitude: knots}]
    value = neutral_value(probe, model) + amplitude
    bare = {"effect": effect.id, **shape[1], probe.amplitude: value}
    if probe.phase is None:
        return [bare]
    return [{**bare, probe.phase: phase} for phase in (0.0, math.pi / 2.0)]


def sight(problem: Problem, asked: Sequence[Shape], limits: Limits) -> Sight:
    """What these recordings show of each shape, beside the model of ``problem``."""
    use = problem.sliding
    base = problem.residual(problem.model)
    own = own_columns(problem, base)[use]
    hold = own[:, [list(ALL).index(HOLD)]]
    scale, rms, distance = problem.scale[use], np.zeros(len(asked)), np.zeros(len(asked))
    for k, shape in enumerate(asked):
        step = probe_step(catalogue()[shape[0]], problem)
        left, size = [], []
        for entry in entries(shape, step, problem.model, limits):
            column = (problem.residual(problem.with_entries([entry])) - base)[use] / step
            if not np.all(np.isfinite(column)):
                column = np.zeros_like(column)
            beside = unexplained(column, own)
            if beside < _OWN * float(column @ column):  # it is one of the model's own numbers
                beside = unexplained(column, hold)
            left.append(beside)
            size.append(float(np.sqrt(np.mean((column * scale) ** 2))) if len(column) else 0.0)
        rms[k], distance[k] = max(size), min(left)
    seconds = sum(float(one.time_s[-1] - one.time_s[0]) for one in problem.recordings)
    return Sight(seconds, float(np.mean(use)) * seconds, rms, distance)


def amplitudes(sights: Sequence[Sight], level_nm: float) -> Floats:
    """Of each shape: where the experiment that shows it best has ``level_nm`` of it (rms)."""
    most = np.max([one.rms_nm for one in sights], axis=0)
    return np.where(most > 0.0, level_nm / np.where(most > 0.0, most, 1.0), 0.0)


def friction_level_nm(model: Model) -> float:
    """The mean of both directions' offsets: what ``matters`` is a share of."""
    return 0.5 * abs(model.friction.offset_pos_nm) + 0.5 * abs(model.friction.offset_neg_nm)


@dataclass(frozen=True)
class Prospect:
    """An experiment's simulated recording, ready to be asked."""

    recording: Prepared
    sight: Sight = field(repr=False)

    def between(self, model: Model, entry: Mapping[str, Any], rival: str) -> float:
        """D² between the finding and its rival, in whatever shape and strength."""
        others = tuple(one for one in model.effects if one["effect"] != entry["effect"])
        bare = replace(model, effects=others)
        problem = Problem([self.recording], bare)
        return separation(problem, entry, rival) + told_apart(
            self.recording, bare, entry, rival, ()
        )


def prospect(
    name: str, series: Mapping[str, Series], model: Model, asked: Sequence[Shape], limits: Limits
) -> Prospect:
    """From the simulated signals of an experiment."""
    recording = prepare(name, series)
    return Prospect(recording, sight(Problem([recording], model), asked, limits))


def wrong(distance: float, discrepancy: float) -> float:
    """ε: how often two models this far apart are taken for one another.

    ``discrepancy``: what is left beside the best model, in noise variances (1: noise alone).
    """
    far = math.sqrt(max(distance, 0.0) / max(discrepancy, 1.0) / CLEAR) * CLEAR_SIGMA
    return 0.5 * math.erfc(far / 2.0 / math.sqrt(2.0))


def information(probability: float, error: float) -> float:
    """Bits that an answer tells which is wrong in a share ``error``, of a yes/no question."""
    yes = probability * (1.0 - error) + (1.0 - probability) * error
    return entropy(yes) - entropy(error)


def entropy(probability: float) -> float:
    """Of a yes/no question, bits."""
    if not 0.0 < probability < 1.0:
        return 0.0
    q = 1.0 - probability
    return -probability * math.log2(probability) - q * math.log2(q)
