"""A motor torque of one value: what it says nothing of, and what is still found beside it."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.balance.still import is_still, of_motor_torque
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model
from eps_hil.series import Series

Recordings = Mapping[str, Mapping[str, Series]]
STIFFNESS_NM_PER_RAD = 0.02


def still(recordings: Recordings, value_nm: float = 0.0) -> Recordings:
    return {
        name: {**one, "motor_torque_nm": Series(one["motor_torque_nm"].t_ns, told)}
        for name, one in recordings.items()
        for told in [np.full(len(one["motor_torque_nm"].t_ns), value_nm)]
    }


@pytest.mark.parametrize("value_nm", [0.0, 0.3])
def test_it_says_nothing_of_what_scales_it(
    record: Callable[..., Recordings], reference_model: Model, value_nm: float
) -> None:
    moving = record({}, ("weave",), seconds=8.0)
    assert not is_still([prepare(name, one) for name, one in moving.items()])
    ready = [prepare(name, one) for name, one in still(moving, value_nm).items()]
    assert is_still(ready)
    assert of_motor_torque(Problem(ready, reference_model)) == [
        "motor_torque_delay",
        "motor_torque_gain",
        "motor_torque_saturation",
        "torque_ripple",
    ]


@pytest.mark.slow
def test_a_torque_that_was_not_recorded_is_no_law(
    record: Callable[..., Recordings], reference_model: Model
) -> None:
    recordings = still(record({}, ("weave",), seconds=12.0))
    kept = still(record({}, ("weave",), seed=2, seconds=12.0))
    others = set(catalogue()) - {"stribeck", "motor_torque_gain"}
    content = diagnose(reference_model, recordings, kept, without=others).content
    assert [one["effect"] for one in content["findings"]] == ["unknown"]
    assert "model" not in content["findings"][0]
    (said,) = [one for one in content["limits"] if "may be the motor's torque" in one]
    assert "motor_torque_gain" in said


@pytest.mark.slow
def test_friction_is_named_where_the_motor_was_off(
    record: Callable[..., Recordings], reference_model: Model, other_rig: Any
) -> None:
    plant = {
        other_rig.EM_GAIN: 0.0,
        other_rig.SPRING: STIFFNESS_NM_PER_RAD,
        other_rig.STRIB: 0.03,
        other_rig.STRIB_W: 10.0,
    }
    spring = {"effect": "unmodelled_spring", "stiffness_nm_per_rad": STIFFNESS_NM_PER_RAD}
    model = replace(reference_model, effects=(spring,))
    recordings = still(record(plant, ("sweep", "weave"), seconds=15.0))
    kept = still(record(plant, ("weave",), seed=2, seconds=15.0))
    content = diagnose(model, recordings, kept).content
    assert [one["effect"] for one in content["findings"]] == ["stribeck"]
