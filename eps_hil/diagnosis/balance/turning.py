"""A stiffer bristle than the model's, judged by the way over which friction turns round: T_fs/σ0.

What a model leaves at a reversal is proportional to that way. Of a rig without presliding (its
friction turns over at once, or goes with a smooth function of speed) the way is nothing, give or
take a little, while σ0 is any large number: its own interval always reaches the model's value.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from eps_hil.diagnosis.balance.fit import BRISTLE, Fit, deviation
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.physics.effects.catalogue import catalogue

_STIFFNESS = "sigma0_nm_per_rad"


def half_widths_off(entry: Mapping[str, Any], half_width: float, problem: Problem) -> float:
    """How many half widths of its 95 % interval an entry's amplitude is from nothing."""
    if half_width == 0.0:
        return float(np.inf)
    # (1/σ0' − 1/σ0) over half_width/σ0² is (σ0 − σ0')/half_width times σ0/σ0'
    return deviation(entry, problem) / half_width * max(stiffer(entry, problem), 1.0)


def stiffer(entry: Mapping[str, Any], problem: Problem) -> float:
    """σ0 of a bristle's entry over the model's; 1 for another effect."""
    if entry["effect"] != BRISTLE:
        return 1.0
    return float(entry[_STIFFNESS]) / problem.model.friction.sigma0_nm_per_rad


def ends_of(
    entry: Mapping[str, Any], name: str, half_width: float, problem: Problem
) -> list[float]:
    """The 95 % interval of a number of an entry; a way down to nothing is a σ0 as large as any."""
    value = float(entry[name])
    if stiffer(entry, problem) <= 1.0:
        return [value - half_width, value + half_width]
    share = half_width / value
    most = _stiffest(problem)
    return [value / (1.0 + share), min(value / (1.0 - share), most) if share < 1.0 else most]


def in_words(problem: Problem, found: Fit, k: int, without: Fit | None, alike: float) -> str:
    """What a stiffer bristle at place ``k`` says of how the rig turns round; else nothing.

    ``without``: the fit that does without it; ``alike``: share of its gain from which another
    explanation is as good.
    """
    times = stiffer(found.entries[k], problem)
    if times <= 1.0:
        return ""
    said = f" Friction turns round over {100.0 / times:.2g} % of the way that the model takes."
    if without is None:
        return said
    none = [dict(one) for one in found.entries]
    none[k][_STIFFNESS] = _stiffest(problem)
    left = problem.residual(problem.with_entries(none, found.own))
    bare, cost, rigid = (problem.cost(one) for one in (without.residual, found.residual, left))
    if bare - rigid > alike * (bare - cost):
        said += " No presliding at all, as of friction that only follows speed, explains as much."
    return said


def _stiffest(problem: Problem) -> float:
    effect = catalogue()[BRISTLE]
    (parameter,) = effect.parameters
    return float(problem.size.bounds(parameter, effect)[1])
