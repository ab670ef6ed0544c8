"""Effects that ask where the rotor is, with a measured angle and without."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.places import effects_of_places
from eps_hil.estimation.validity import Reason
from eps_hil.physics.effects.catalogue import catalogue, with_model_effects
from eps_hil.physics.model import Model

from .prescribed import SPEED_ONLY, Prescribed, at, friction_nm, ramp

OF_PLACES = {
    "cardan_joint",
    "cogging_torque",
    "end_stop",
    "position_dependent_friction",
    "position_torque",
    "screw_ripple",
    "torque_ripple",
    "unmodelled_spring",
}
SPRING = {"effect": "unmodelled_spring", "stiffness_nm_per_rad": 0.002}
LAW = {"effect": "empirical", "form": "law", "where": "rotor", "shapes": ["linear"], "size": 0.01}


def test_effects_of_places_are_told_from_the_others(reference_model: Model) -> None:
    with_kernel = [e for e in catalogue().values() if e.kernel is not None and e.read is None]
    entries = tuple({"effect": effect.id} for effect in with_kernel)
    assert set(effects_of_places(replace(reference_model, effects=entries))) == OF_PLACES


@pytest.mark.parametrize(
    ("entry", "asks"),
    [
        ({"effect": "rack_ratio", "scale": 0.02}, False),
        ({"effect": "rack_ratio", "scale": 0.02, "slope_per_m": 1.0}, True),
        ({**LAW, "inputs": ["motor_speed_rad_s"]}, False),
        ({**LAW, "inputs": ["rack_position_m"]}, True),
        ({**LAW, "inputs": ["motor_angle_rad"], "memory": ["stop"], "memory_1": 0.1}, False),
        (
            {**LAW, "inputs": ["motor_angle_rad"], "memory": ["stop"], "memory_1": 0.1,
             "range": {"motor_angle_rad": [-1.0, 1.0]}},
            True,
        ),
    ],
)  # fmt: skip
def test_an_entry_asks_by_what_it_says(
    reference_model: Model, entry: dict[str, Any], asks: bool
) -> None:
    model = with_model_effects(replace(reference_model, effects=(entry,)))
    assert bool(effects_of_places(model)) is asks


@pytest.mark.parametrize("kind", ["observer", "bristle_filter"])
def test_a_spring_without_an_angle_is_not_believed(reference_model: Model, kind: str) -> None:
    """Its torque was that of an angle that begins at zero: 224 N off, and valid."""
    way, force = ramp(1.5, 20.0, 0.1), np.full(1500, 400.0)
    friction = friction_nm(reference_model, way, force)
    spring_nm = 0.002 * (50.0 + 1e-3 * np.cumsum(way))
    rig = Prescribed(reference_model, way, force, friction, spring_nm, first_rad=50.0)
    model = replace(rig.model, effects=(SPRING,))
    seen = rig.estimate((*SPEED_ONLY, "motor_angle_rad"), model, kind=kind)
    late = at(seen, 1.2, 1.4)
    assert np.all(seen.valid[late])
    assert abs(np.mean(rig.error_n(seen)[late])) < 5.0
    blind = rig.estimate(SPEED_ONLY, model, kind=kind)
    assert not np.any(blind.valid)
    assert np.all(blind.reason[at(blind, 1.2, 1.4)] == int(Reason.OUT_OF_RANGE))
