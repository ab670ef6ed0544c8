"""Cells: what is planted in a corner is found there, and nothing in noise."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.mismatch.regions import cells, operating_region, sentence
from eps_hil.physics.model import Model


@pytest.fixture(scope="module")
def problem(record: Callable[..., Any], reference_model: Model) -> Problem:
    made = record({}, ("sweep", "weave", "slow"), seconds=20.0)
    return Problem([prepare(name, one) for name, one in made.items()], reference_model)


def test_a_corner_of_two_signals_is_found(problem: Problem) -> None:
    where = operating_region(problem)
    inside = (where["rack_force_n"] < -200) & (where["motor_speed_rad_s"] > 5.0)
    noise = np.random.default_rng(1).standard_normal(len(inside)) ** 2
    found = cells(problem, noise + 8.0 * inside)
    pair = next(
        c for c in found if {s[0] for s in c.sides} == {"rack_force_n", "motor_speed_rad_s"}
    )
    assert pair.share > 1.5 * pair.time
    assert pair.p < 0.01
    middle = {name: 0.5 * (low + high) for name, low, high in pair.sides}
    assert middle["rack_force_n"] < -200
    assert middle["motor_speed_rad_s"] > 5.0
    assert "% of the time" in sentence(found)


@pytest.mark.parametrize("seed", range(4))
def test_noise_is_nowhere(problem: Problem, seed: int) -> None:
    noise = np.random.default_rng(seed).standard_normal(len(problem.scale)) ** 2
    assert cells(problem, noise) == []
    assert sentence([]) == ""


def test_time_since_reversal_and_dwell(problem: Problem) -> None:
    where = operating_region(problem)
    assert np.all(where["since_reversal_s"] >= 0)
    assert np.max(where["since_reversal_s"]) < 25
    assert np.all(where["dwell_s"] >= 0)
