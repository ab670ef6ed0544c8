"""A rack force that is worth something else than the ratio, which is measured, makes it."""

import pytest

from eps_hil.diagnosis.accept.measured_ratio import settled
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.verdict.finding import unknown

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("scale", "worth"), [(0.03, "2.91% less"), (-0.02, "2.04% more")])
def test_a_ratio_that_is_measured_is_no_finding_of_the_balance(
    problem: Problem, scale: float, worth: str
) -> None:
    entries = [
        {"effect": "rack_ratio", "scale": scale},
        {"effect": "motor_torque_gain", "gain": 1.02},
    ]
    found = fit(problem, entries, 0)
    selection = Selection(found, found, [], problem, found)
    selection.rivals = {"motor_torque_gain": [("rack_ratio", 0.99), ("inertia", 0.97)]}
    selection.gains = {"rack_ratio": 900.0, "motor_torque_gain": 5000.0}
    assert settled(problem, selection, [0, 1], False) == ([0, 1], None)
    assert selection.rivals["motor_torque_gain"][0][0] == "rack_ratio"
    findings, left = settled(problem, selection, [0, 1], True)
    assert findings == [1]
    assert selection.rivals == {"motor_torque_gain": [("inertia", 0.97)]}
    assert left is not None
    told = unknown(left)
    assert worth in told["summary"]
    assert told["where"][0]["signal"] == "rack_force_n"
    assert settled(problem, selection, [1], True) == ([1], None)
