"""Which effects hold where they were not fitted, and the model with them."""

from dataclasses import replace
from typing import Any

import pytest

from eps_hil.diagnosis.borne_out import _clear, augmented_by
from eps_hil.diagnosis.fit import fit
from eps_hil.diagnosis.problem import Problem

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("entry", "half", "expected"),
    [
        ({"effect": "inertia", "scale": 1.1}, {"scale": 0.05}, True),
        ({"effect": "inertia", "scale": 1.1}, {"scale": 0.2}, False),
        (
            {"effect": "stribeck", "level_nm": 0.1, "speed_rad_s": 5.0},
            {"level_nm": 0.2, "speed_rad_s": 20.0},
            True,  # they are hard to tell apart, not hard to see
        ),
    ],
)
def test_one_number_that_may_as_well_be_nothing_is_no_finding(
    problem: Problem, entry: dict[str, Any], half: dict[str, float], expected: bool
) -> None:
    found = fit(problem, [entry], 0)
    found.__dict__["half_width"] = {(0, name): value for name, value in half.items()}
    assert _clear(problem, found, 0) is expected


def test_the_model_with_findings_holds_no_other_entry_and_no_negative_delay(
    problem: Problem,
) -> None:
    entries = [
        {"effect": "stribeck", "level_nm": 0.0301234567, "speed_rad_s": 10.0},
        {"effect": "quadratic_drag", "coefficient_nm_s2_per_rad2": 1e-5},
    ]
    found = replace(fit(problem, entries, 0), own={"motor_torque_delay": 100.0})
    with_one = augmented_by(problem, found, [0])
    assert with_one.effects == ({"effect": "stribeck", "level_nm": 0.0301235, "speed_rad_s": 10.0},)
    assert with_one.delays_s.motor_torque == 0.0
    assert augmented_by(problem, found, []) is problem.model
