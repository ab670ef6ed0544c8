"""Two states that share something without a name: what differs is named, what is alike is not."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.beside_shared import alike, beside_shared
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.model import Model

BRAKE_NM, SPRING = 0.05, 4e-4


@pytest.mark.slow
@pytest.mark.parametrize("spring", [SPRING, 0.0])
def test_a_spring_that_came_beside_a_brake_that_was_there(
    spring: float, record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """The eddy-current brake leaves many times what the spring does, in both states."""
    brake = {other_rig.EDDY: BRAKE_NM, other_rig.EDDY_W: 30.0}

    def state(plant: dict[int, float], seed: int) -> Diagnosis:
        """Of a state in which no name was found."""
        *fitted, kept = record(plant, ("sweep", "weave", "slow"), seed, seconds=12.0).items()
        problem = Problem([prepare(*one) for one in fitted], reference_model)
        nothing = fit(problem, [])
        selection = Selection(nothing, nothing, [], problem, nothing)
        judged = [Holdout(prepare(*kept), kept[1])]
        return Diagnosis({}, reference_model, problem, selection, judged, ())

    before, after = state(brake, 3), state({**brake, other_rig.SPRING: spring}, 4)
    assert alike(before, after)
    way = beside_shared(before, "before", after, None)
    if not spring:
        assert way.told() == []
        assert way.other.content["verdict"] == "no_mismatch"
        assert way.other.model == reference_model
        return
    ((_, finding),) = way.told()
    assert finding["effect"] == "unmodelled_spring"
    stiffness = finding["parameters"]["stiffness_nm_per_rad"]
    assert stiffness["value"] == pytest.approx(spring, rel=0.15)
    assert abs(way.change(0)["share_before"]["value"]) < 0.3
    assert way.change(0)["is"] == "new"
    assert [one["effect"] for one in way.other.model.effects] == ["unmodelled_spring"]
    assert type(way.other.model) is Model
