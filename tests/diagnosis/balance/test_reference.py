"""Whether a motor's torque has another one to be measured by."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.balance.reference import gain_is_observable, torque_is_referenced
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.remainder.sight import Sight
from eps_hil.physics.model import Model

pytestmark = pytest.mark.slow


def without_load(problem: Problem) -> Problem:
    """The same motion on a free axis: a load of zero where there is known none, no torsion bar."""
    free = []
    for one in problem.recordings:
        raw = {k: v for k, v in one.raw.items() if k not in ("torque_sensor_nm", "rack_force_n")}
        zero = np.zeros(len(one.time_s))
        free.append(replace(one, raw={**raw, "rack_force_n": zero}, _shifted={}))
    return replace(problem, recordings=free)


def test_a_load_cell_tells_what_the_motors_torque_is_worth(problem: Problem) -> None:
    assert torque_is_referenced(problem)
    assert not torque_is_referenced(without_load(problem))


def test_nothing_over_the_motors_torque_explains_it_without_one(problem: Problem) -> None:
    alone = without_load(problem)
    known = Sight(alone, alone.model)
    unsure = Sight(alone, alone.model, referenced=False)
    assert "motor_torque_nm" in known.inputs
    assert not any("motor_torque" in name or "power" in name for name in unsure.inputs)
    assert any(where == "motor" for where, _ in known.places)
    assert not any(where == "motor" for where, _ in unsure.places)


def test_a_load_that_only_follows_the_motion_is_none(
    record: Callable[..., Any], reference_model: Model
) -> None:
    """A spring that was fitted because nobody measured the force."""
    made = [prepare(n, one) for n, one in record({}, ("weave",), seconds=10.0).items()]
    springs = []
    for one in made:
        force = 3e4 * one.raw["motor_angle_rad"] / reference_model.rack_to_rotor_ratio_rad_per_m
        raw = {k: v for k, v in one.raw.items() if k != "torque_sensor_nm"}
        springs.append(replace(one, raw={**raw, "rack_force_n": force}, _shifted={}))
    tied = {"unmodelled_spring": 0.0, "motor_torque_offset": 0.0}
    assert not torque_is_referenced(Problem(springs, reference_model, tied=tied))


@pytest.mark.parametrize(("load", "shown"), [("measured", True), ("constant", False)])
def test_a_gain_shows_beside_a_load_that_varies(problem: Problem, load: str, shown: bool) -> None:
    one, *_ = problem.recordings
    if load == "constant":  # and the motor's torque is what the model makes of the motion
        force = np.full(len(one.time_s), 200.0) + 2.0 * np.sin(1e4 * one.time_s)
        still = {**one.raw, "rack_force_n": force, "torque_sensor_nm": 0.0 * force}
        bare = one.changed(raw={**still, "motor_torque_nm": 0.0 * force})
        late = round(1e3 * problem.model.delays_s.motor_torque)
        torque = np.roll(-bare.balance(problem.model), late)
        one = bare.changed(raw={**still, "motor_torque_nm": torque})
        assert np.std(one.left_over(problem.model)) < 0.01 * np.std(torque)
    alone = Problem([one], problem.model)
    more = one.changed(raw={**one.raw, "motor_torque_nm": 1.01 * one.raw["motor_torque_nm"]})
    moved = (more.left_over(problem.model) - one.left_over(problem.model)) / alone.scale
    assert gain_is_observable(alone, moved[:, None]) is shown
    assert torque_is_referenced(alone) is shown


def test_a_load_that_was_assumed_measures_nothing(problem: Problem) -> None:
    """Whatever it does: it was fitted to the motor's torque itself."""
    assumed = [
        replace(
            one,
            raw={k: v for k, v in one.raw.items() if k != "torque_sensor_nm"},
            load_is_assumed=True,
            _shifted={},
        )
        for one in problem.recordings
    ]
    measured = [replace(one, load_is_assumed=False, _shifted={}) for one in assumed]
    assert torque_is_referenced(replace(problem, recordings=measured))
    assert not torque_is_referenced(replace(problem, recordings=assumed))
