"""Trees take off what follows the inputs, and nothing of what does not."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.remainder.ceiling import left_by_trees
from eps_hil.diagnosis.remainder.intervals import parameters
from eps_hil.physics.model import Model

Pair = tuple[Problem, Problem]


@pytest.fixture(scope="module")
def pair(record: Callable[..., Any], reference_model: Model, other_rig: Any) -> Pair:
    """A rig with a drag that its model lacks: fitted recordings and a hold-out."""
    plant = {other_rig.QUAD: 2e-5}
    made = record(plant, ("sweep", "weave", "slow"), seconds=20.0)
    kept = record(plant, ("weave", "slow"), seconds=20.0, seed=2)
    return tuple(  # type: ignore[return-value]
        Problem([prepare(name, one) for name, one in some.items()], reference_model)
        for some in (made, kept)
    )


def energy(problem: Problem, residual: Any) -> float:
    return float(np.mean(residual[problem.sliding] ** 2))


LAW = {
    "effect": "empirical", "form": "law", "where": "rotor", "how": "sum",
    "inputs": ["motor_speed_rad_s", "abs_motor_speed_rad_s"], "memory": ["none", "none"],
    "shapes": ["linear", "linear"], "size": 2e-5,
}  # fmt: skip


def test_what_a_law_would_take_off_trees_nearly_do(pair: Pair) -> None:
    problem, kept = pair
    law = replace(problem.model, effects=(LAW,))
    before, after = (energy(kept, kept.residual(one)) for one in (problem.model, law))
    left = energy(kept, left_by_trees(problem, kept, problem.model))
    assert before > 3.0 * after
    assert left < after + 0.2 * (before - after)


@pytest.mark.slow
def test_trees_gain_nothing_where_nothing_is_left(pair: Pair) -> None:
    problem, kept = pair
    law = replace(problem.model, effects=(LAW,))
    after = energy(kept, kept.residual(law))
    assert energy(kept, left_by_trees(problem, kept, law)) == pytest.approx(after, rel=0.05)


def test_a_laws_numbers_have_intervals_that_hold_them(pair: Pair) -> None:
    problem, _ = pair
    told = parameters(problem, replace(problem.model, effects=(LAW,)), [LAW])
    low, high = told["size"]["ci95"]
    assert told["size"]["unit"] == "Nm/((rad/s)^2)"
    assert low < 2e-5 < high
    assert high - low < 0.2 * 2e-5
    table = {**LAW, "form": "curve", "values": [0.0, 1.0]}
    assert parameters(problem, problem.model, [table]) == {}
