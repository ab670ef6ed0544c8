"""How a simulator turns round is read from its traces, and the recordings are asked for it."""

from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any

import pytest

from eps_hil.diagnosis.against import diagnose_against
from eps_hil.diagnosis.simulator.differences import comparable
from eps_hil.physics.model import Model

MANOEUVRES = ("sweep", "weave", "slow")


def test_only_an_effect_of_one_size_can_be_asked_for() -> None:
    assert comparable({"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 8.0})
    assert not comparable({"effect": "stribeck", "level_nm": 0.0, "speed_rad_s": 8.0})
    assert not comparable({"effect": "presliding_hysteresis", "sigma0_nm_per_rad": 9.0})
    assert not comparable({"effect": "torque_sensor_gain", "gain": 1.1})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("simulator", "rig", "numbers", "rig_only"),
    [
        (0.3, 0.3, [], []),
        (0.3, 0.0, ["friction.sigma0_nm_per_rad"], ["presliding_hysteresis"]),
        (0.0, 0.3, ["friction.sigma0_nm_per_rad"], []),
    ],
)
def test_a_simulator_without_presliding_is_told_from_a_rig_with_it(
    record: Callable[..., Any],
    reference_model: Model,
    other_rig: ModuleType,
    simulator: float,
    rig: float,
    numbers: list[str],
    rig_only: list[str],
) -> None:
    def plant(speed_rad_s: float) -> Mapping[int, float]:
        return {other_rig.SMOOTH: speed_rad_s}

    traces = record(plant(simulator), MANOEUVRES, noise=0.0, speed_late_s=-4e-3, torque_late_s=1e-3)
    told = diagnose_against(
        {f"sim_{name}": one for name, one in traces.items()},
        reference_model,
        record(plant(rig), MANOEUVRES),
        record(plant(rig), ("weave", "slow"), seed=2),
    ).content["simulation"]["differences"]
    assert [one["name"] for one in told["numbers"]] == numbers
    assert [one["effect"] for one in told["rig_only"]] == rig_only
    assert told["same"] == []
    for one in told["numbers"]:
        assert (one["rig"] > one["simulator"]) is (rig > simulator)
