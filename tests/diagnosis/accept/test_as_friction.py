"""Laws of the friction level leave friction where the rotor slows down."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.accept.as_friction import as_friction
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.remainder.find import Remainder, Term
from eps_hil.physics.balance import sliding_levels_nm

pytestmark = pytest.mark.slow


def remainder(problem: Problem, size: float, how: str = "factor") -> Remainder:
    entry: dict[str, Any] = {
        "effect": "empirical", "form": "law", "where": "friction", "how": how,
        "inputs": ["abs_motor_speed_rad_s"], "memory": ["none"], "shapes": ["gaussian"],
        "size": size, "centre_1": 0.0, "width_1": 5.0,
        "range": {"abs_motor_speed_rad_s": [0.0, 200.0]},
    }  # fmt: skip
    model = replace(problem.model, effects=(entry,))
    left = problem.residual(problem.model)
    return Remainder((Term(entry, None),), model, 0.9, (0.8, 1.0), left, problem.residual(model))


def least_share(problem: Problem, found: Remainder) -> float:
    """Of the level without the law, at standstill."""
    motion = problem.recordings[0].motion(found.model)
    still = motion._replace(speed_rad_s=np.copysign(1e-6, motion.speed_rad_s))
    with_it, without = (sliding_levels_nm(one, still) for one in (found.model, problem.model))
    return float(np.min(with_it / without))


@pytest.mark.parametrize("how", ["factor", "sum"])
def test_a_law_that_takes_all_of_the_level_and_more_is_no_larger_than_leaves_some(
    problem: Problem, how: str
) -> None:
    found = remainder(problem, -1.05 if how == "factor" else -0.3, how)
    assert least_share(problem, found) < 1e-3  # no level acts below zero
    told = as_friction(problem, problem, found)
    assert least_share(problem, told) == pytest.approx(0.02, abs=0.002)
    assert abs(told.entries[0]["size"]) < abs(found.entries[0]["size"])
    assert told.model.effects == told.entries
    np.testing.assert_array_equal(told.after, problem.residual(told.model))


@pytest.mark.parametrize("size", [-0.9, 0.5])
def test_a_law_that_leaves_friction_stays_as_it_is(problem: Problem, size: float) -> None:
    found = remainder(problem, size)
    assert as_friction(problem, problem, found) is found
