"""What only a hold-out shows: no all-clear and no whole explanation, and what it may be."""

from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any

import pytest

from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Model


@pytest.mark.parametrize(
    ("everywhere", "verdict"),
    [({}, "unknown_effect"), ({"VISC": 6e-4}, "partly_explained")],
)
def test_what_only_a_holdout_shows_is_unknown_and_said_to_be_there(
    record: Callable[..., Any],
    reference_model: Model,
    other_rig: ModuleType,
    everywhere: Mapping[str, float],
    verdict: str,
) -> None:
    """A rig whose friction falls with speed after the fitted recordings were made."""
    plant = {getattr(other_rig, name): value for name, value in everywhere.items()}
    fitted = record(plant, ("sweep", "weave"))
    worn = {**plant, other_rig.STRIB: 0.05, other_rig.STRIB_W: 10.0}
    kept = record(worn, ("weave",), seed=2)
    content = diagnose(reference_model, fitted, kept).content
    assert content["verdict"] == verdict
    *named, there = content["findings"]
    assert [one["effect"] for one in named] == (["viscous_friction"] if everywhere else [])
    assert there["effect"] == "unknown"
    assert "weave_2 leaves" in there["summary"]
    assert there["confusable_with"] == ["stribeck"]
    assert there["where"][0]["signal"] in ("motor_speed_rad_s", "abs_motor_speed_rad_s")
    assert any("fit a recording like it too" in one for one in content["limits"])


def test_a_holdout_that_shows_the_same_adds_nothing(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    plant = {other_rig.STRIB: 0.05, other_rig.STRIB_W: 10.0}
    told = diagnose(
        reference_model, record(plant, ("sweep", "weave")), record(plant, ("weave",), 2)
    )
    assert told.content["verdict"] == "explained"
    assert [one["effect"] for one in told.content["findings"]] == ["stribeck"]
