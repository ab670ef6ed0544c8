"""What is said of rotor against rack beside the findings."""

import pytest

from eps_hil.diagnosis.direct.kinematics import small_ratio


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
