"""95 % intervals of the numbers of laws that were found, all together, by the simulator itself."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eps_hil.diagnosis.balance.problem import Problem, huber, knee
from eps_hil.diagnosis.balance.spread import half_widths
from eps_hil.diagnosis.remainder.as_effect import free_numbers, unit_of
from eps_hil.physics.model import Model

Entry = Mapping[str, Any]
_STEP = 0.01


def parameters(
    problem: Problem, model: Model, entries: Sequence[Entry]
) -> dict[str, dict[str, Any]]:
    """``parameters`` of CONTRACT 7 for the laws among ``entries``, which ``model`` holds.

    Correlated residuals count once (``spread.py``); the model's own numbers are as unsure
    as their prior, and move with the law's. Of several terms the second's are ``size of term 2``,
    … Curves and maps have none.
    """
    base = problem.residual(model)
    told: dict[str, dict[str, Any]] = {}
    columns, keys = [], []
    for k, entry in enumerate(entries):
        if "values" in entry:
            continue
        for name, value in free_numbers(entry).items():
            step = _STEP * max(abs(value), 1.0 if name.startswith("phase") else 1e-6)
            moved = {**entry, name: value + step}
            effects = tuple(moved if one == entry else one for one in model.effects)
            left = problem.residual(replace(model, effects=effects))
            columns.append((left - base) / step)
            keys.append((name if k == 0 else f"{name} of term {k + 1}", value, entry, name))
    if not columns:
        return told
    weight = np.sqrt(np.where(problem.sliding, huber(base, knee(base)), 0.0))
    own = list(problem.columns.values())
    jacobian = np.column_stack([*own, *columns]) * weight[:, None]
    wide = half_widths(jacobian, base * weight, (problem.block, problem.stretch), len(own))
    for (key, value, entry, name), half in zip(keys, wide[len(own) :].tolist(), strict=True):
        ends = [value - half, value + half] if math.isfinite(half) else None
        told[key] = {"value": value, "unit": unit_of(entry, name), "ci95": ends}
    return told
