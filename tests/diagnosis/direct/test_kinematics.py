"""What is said of rotor against rack beside the findings."""

import pytest

from eps_hil.diagnosis.direct.kinematics import examine, small_ratio, where_friction_acts
from eps_hil.physics.model import Model
from tests.diagnosis.direct.test_belt import recorded


@pytest.mark.parametrize(
    ("off", "named", "told"),
    [(-0.003, False, "-0.30%"), (5e-4, False, ""), (0.03, True, ""), (0.002, False, "+0.20%")],
)
def test_a_ratio_that_is_a_little_off_is_told(off: float, named: bool, told: str) -> None:
    findings = [{"effect": "rack_ratio"}] if named else [{"effect": "stribeck"}]
    said = small_ratio({"kinematics": {"ratio_error": off}, "findings": findings})
    assert bool(said) is bool(told)
    assert told in "".join(said)


def test_without_a_rack_position_there_is_nothing_to_tell() -> None:
    assert small_ratio({"kinematics": {}, "findings": []}) == []
    assert small_ratio({"findings": []}) == []


@pytest.mark.slow
@pytest.mark.parametrize("behind", [False, True])
def test_where_friction_acts_is_seen_at_a_gap(reference_model: Model, behind: bool) -> None:
    first, second = recorded(gap_rad=0.05, rubs_behind=behind)
    found = examine([first], [second], reference_model)
    (gap,) = found.seen
    assert gap.entry["effect"] == "backlash"
    assert gap.entry["gap_rad"] == pytest.approx(0.05, rel=0.03)
    assert found.left is None
    assert found.behind is behind
    assert bool(where_friction_acts({"kinematics": found.content})) is behind


@pytest.mark.slow
@pytest.mark.parametrize("behind", [False, True])
def test_a_belt_is_as_stiff_whatever_rubs_behind_it(reference_model: Model, behind: bool) -> None:
    first, second = recorded(belt_nm_per_rad=5.0, rubs_behind=behind)
    found = examine([first], [second], reference_model)
    (belt,) = found.seen
    assert belt.entry["stiffness_nm_per_rad"] == pytest.approx(5.0, rel=0.02)
    assert found.behind is behind


def test_one_piece_says_nothing_of_where_friction_acts() -> None:
    assert where_friction_acts({}) == []
    assert where_friction_acts({"kinematics": {"ratio_error": 0.0}}) == []
