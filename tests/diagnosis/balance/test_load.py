"""What a load that was not measured makes doubtful."""

import pytest

from eps_hil.diagnosis.balance.load import Load, doubted


def finding(effect: str) -> dict[str, object]:
    return {"effect": effect, "confidence": 0.9, "confusable_with": [], "next_experiment": ""}


def test_friction_at_a_place_may_be_friction_of_a_springs_load() -> None:
    spring = Load("spring", 5e4, 100.0, 0.0)
    place, other = doubted(
        [finding("position_dependent_friction"), finding("cogging_torque")], spring
    )
    assert place["confusable_with"] == ["load_dependent_friction"]
    assert place["confidence"] == 0.45
    assert "record the rack force" in str(place["next_experiment"])
    assert other == finding("cogging_torque")


@pytest.mark.parametrize("load", [None, Load("arbitrary", 0.0, 0.0, 0.0)])
def test_without_a_spring_it_stands(load: Load | None) -> None:
    one = finding("position_dependent_friction")
    assert doubted([one], load) == [one]
