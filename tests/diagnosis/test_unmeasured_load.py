"""What is said of a load that nobody measured."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.diagnosis.unmeasured_load import _may_be_load


def _told(effect: str, *terms: dict[str, Any]) -> Diagnosis:
    found = {"effect": effect, "model": {"law": "T_f + 0.1 · h", "terms": list(terms)}}
    return cast(Diagnosis, SimpleNamespace(content={"findings": [found]}))


@pytest.mark.parametrize("name", ["motor_angle_rad", "abs_motor_speed_rad_s", "rack_position_m"])
def test_a_nameless_torque_that_follows_the_motion_may_be_the_load(name: str) -> None:
    (said,) = _may_be_load(_told("unknown", {"where": "rotor", "inputs": [name]}))
    assert "T_f + 0.1 · h" in said
    assert "Record rack_force_n" in said


@pytest.mark.parametrize(
    ("effect", "term"),
    [
        ("unknown", {"where": "rotor", "inputs": ["motor_angle_rad", "motor_torque_nm"]}),
        ("unknown", {"where": "motor", "inputs": ["motor_angle_rad"]}),
        ("cogging_torque", {"where": "rotor", "inputs": ["motor_angle_rad"]}),
    ],
)
def test_what_depends_on_more_or_has_a_name_is_no_load(effect: str, term: dict[str, Any]) -> None:
    assert _may_be_load(_told(effect, term)) == []


def test_an_unknown_without_a_model_says_nothing_of_the_load() -> None:
    told = cast(Diagnosis, SimpleNamespace(content={"findings": [{"effect": "unknown"}]}))
    assert _may_be_load(told) == []
