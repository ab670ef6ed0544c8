"""Two states that share something without a name: what differs is named, what is alike is not."""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.beside_shared import alike, beside_shared
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.diagnosis.remainder.find import Remainder, Term, rounded
from eps_hil.physics.model import Model

BRAKE_NM, BRAKE_RAD_S, SPRING, WEAK_SPRING = 0.05, 30.0, 4e-4, 2e-5


def law_of_the_brake(model: Model) -> Remainder:
    """As a diagnosis finds it, its numbers 3 % off."""
    speed = "motor_speed_rad_s"
    entry = {
        "effect": "empirical", "form": "law", "where": "rotor", "how": "sum",
        "inputs": [speed, speed], "memory": ["none", "none"], "shapes": ["linear", "rational"],
        "size": 1.03 * 2.0 * BRAKE_NM / BRAKE_RAD_S, "width_2": 0.97 * BRAKE_RAD_S,
        "range": {speed: [-400.0, 400.0]},
    }  # fmt: skip
    with_it = replace(model, effects=(entry,))
    return Remainder((Term(entry, None),), with_it, 1.0, (1.0, 1.0), np.zeros(0), np.zeros(0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spring", "law"), [(SPRING, False), (0.0, False), (WEAK_SPRING, True), (0.0, True)]
)
def test_a_spring_that_came_beside_a_brake_that_was_there(
    spring: float,
    law: bool,
    record: Callable[..., Any],
    reference_model: Model,
    other_rig: ModuleType,
) -> None:
    """The eddy-current brake leaves many times what the spring does, in both states.

    A spring of a twentieth is seen where a law of the brake is in both.
    """
    brake = {other_rig.EDDY: BRAKE_NM, other_rig.EDDY_W: BRAKE_RAD_S}
    shared = law_of_the_brake(reference_model) if law else None
    base = shared.model if shared else reference_model

    def state(plant: dict[int, float], seed: int) -> Diagnosis:
        """Of a state in which no name was found."""
        *fitted, kept = record(plant, ("sweep", "weave", "slow"), seed, seconds=12.0).items()
        problem = Problem([prepare(*one) for one in fitted], reference_model)
        nothing = fit(problem, [])
        selection = Selection(nothing, nothing, [], problem, nothing)
        judged = [Holdout(prepare(*kept), kept[1])]
        return Diagnosis({}, reference_model, problem, selection, judged, (), shared)

    before, after = state(brake, 3), state({**brake, other_rig.SPRING: spring}, 4)
    assert alike(before, after)
    way = beside_shared(before, "before", after, None)
    if not spring:
        assert way.told() == []
        assert way.other.content["verdict"] == "no_mismatch"
        assert way.other.model == base
        return
    ((_, finding),) = way.told()
    assert finding["effect"] == "unmodelled_spring"
    stiffness = finding["parameters"]["stiffness_nm_per_rad"]
    assert stiffness["value"] == pytest.approx(spring, rel=0.15)
    assert stiffness["ci95"][0] > 0.0
    assert abs(way.change(0)["share_before"]["value"]) < 0.3
    assert way.change(0)["is"] == "new"
    assert [one["effect"] for one in way.other.model.effects] == [
        *(one["effect"] for one in base.effects), "unmodelled_spring"
    ]  # fmt: skip
    for one in way.other.model.effects:  # as a file is written
        assert dict(one) == rounded(one)
    assert type(way.other.model) is Model
