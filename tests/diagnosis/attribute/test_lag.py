"""Dead time or lag: how a late torque is late."""

from collections.abc import Callable
from typing import Any

import pytest

from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Model

pytestmark = pytest.mark.slow

HELD_S = 0.5e-3
"""This rig holds its torque for a sample of 1 ms."""


@pytest.mark.parametrize(("dead_s", "lag_s"), [(10e-3, 0.0), (0.0, 20e-3), (6e-3, 12e-3)])
def test_a_late_torque_says_how_much_of_it_is_a_lag(
    record: Callable[..., Any], reference_model: Model, dead_s: float, lag_s: float
) -> None:
    late = {"torque_late_s": dead_s, "torque_lag_s": lag_s}
    told = diagnose(reference_model, record({}, **late), record({}, ("weave",), 2, **late)).content
    assert told["verdict"] == "explained"
    (finding,) = told["findings"]
    assert finding["effect"] == "motor_torque_delay"
    values = {name: one["value"] for name, one in finding["parameters"].items()}
    late_s = dead_s + lag_s + HELD_S
    assert values["delay_s"] == pytest.approx(late_s, rel=0.02)
    assert values.get("lag_share", 0.0) == pytest.approx(lag_s / late_s, abs=0.08)
    assert ("low-pass" in finding["summary"]) is (lag_s > dead_s)
    if "lag_share" in finding["parameters"]:
        low, high = finding["parameters"]["lag_share"]["ci95"]
        assert 0.0 <= low < high <= 1.0
    assert not [one for one in told["limits"] if "lag_share" in one]
    floor = told["fit"]["holdout"]["noise_floor"]["torque_nrmse"]
    assert told["fit"]["holdout"]["augmented"]["torque_nrmse"] < 1.05 * floor
