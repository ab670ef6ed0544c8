"""The weighted residual: its cost, by Huber's own formula."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from eps_hil.diagnosis.balance.fit import ablated, fit
from eps_hil.diagnosis.balance.problem import Floats, Problem
from eps_hil.physics.model import Model


def test_the_cost_is_twice_hubers_loss(problem: Problem) -> None:
    problem.knee = 4.0
    small, large = np.array([0.0, -1.0, 3.9]), np.array([4.0, -5.0, 1e3])
    assert problem.cost(small) == pytest.approx(float(np.sum(small**2)))
    assert problem.cost(large) == pytest.approx(float(np.sum(4.0 * (2.0 * np.abs(large) - 4.0))))


def test_a_trial_that_blows_up_costs_much_and_says_nothing(problem: Problem) -> None:
    """A step of a fit may go anywhere; what it prints, a user reads."""
    problem.knee = 4.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert problem.cost(np.array([1e200, -1e300])) > 1e300


def test_a_fit_that_cannot_begin_where_it_should_begins_nearer(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numbers that went with an effect may be no friction without it, and its bristle blow up."""
    plain, asked = Problem.residual, list[float]()

    def blows_up(self: Problem, model: Model) -> Floats:
        found = plain(self, model)
        asked.append(model.inertia_kg_m2 / problem.model.inertia_kg_m2)
        return np.full_like(found, np.nan) if len(asked) <= 2 else found

    monkeypatch.setattr(Problem, "residual", blows_up)
    found = fit(problem, [], 0, {"inertia": 0.8})
    assert found.own == {"inertia": 0.2}
    assert np.isfinite(found.cost)
    assert asked[0] > asked[1] > asked[2]


@pytest.mark.slow
def test_a_number_that_recordings_say_nothing_of_comes_back(problem: Problem) -> None:
    """The model's own numbers pay for being moved: there the prior is all that pulls."""
    rest = problem.over([one.changed() for one in problem.recordings])
    rest.scale = np.full_like(problem.scale, 1e6)  # noise that drowns everything
    found = fit(rest, [], own={"inertia": 2.0, "sigma1_nm_s_per_rad": -1.0})
    assert found.own == pytest.approx({"inertia": 0.0, "sigma1_nm_s_per_rad": 0.0}, abs=0.02)
    assert found.cost < 0.01 + rest.cost(rest.residual(rest.model))


def test_a_fit_without_a_name_is_made_once(problem: Problem) -> None:
    """As long as outliers are the same ones; of another fit it is made anew."""
    entry = {"effect": "coulomb_level", "scale": 1.1}
    found = fit(problem, [entry], 1)
    once = ablated(problem, found, 0, 1)
    assert ablated(problem, found, 0, 1) is once
    assert ablated(problem, replace(found), 0, 1) is not once
    once = ablated(problem, found, 0, 1)
    problem.knee *= 2.0
    assert ablated(problem, found, 0, 1) is not once


def test_two_forms_of_a_gain_leave_as_much_in_the_noise_of_one_model(problem: Problem) -> None:
    """A law that takes torque off does not say that it takes off noise, a gain does."""
    gain = replace(problem.model, effects=({"effect": "motor_torque_gain", "gain": 0.8},))
    law = {
        "effect": "empirical", "form": "law", "where": "rotor", "how": "sum",
        "inputs": ["motor_torque_nm"], "memory": ["none"], "shapes": ["linear"],
        "size": 0.2, "range": {"motor_torque_nm": [-9.0, 9.0]},
    }  # fmt: skip
    as_law = replace(problem.model, effects=(law,))
    one, other = (problem.residual(model, problem.model) for model in (gain, as_law))
    np.testing.assert_allclose(one, other, atol=0.02)
    assert np.max(np.abs(problem.residual(gain) - problem.residual(as_law))) > 1.0
