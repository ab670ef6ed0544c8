"""The chain that is assumed for a model file (rig/assumed_chain.py)."""

from dataclasses import replace
from pathlib import Path

import pytest

from eps_hil.physics.chain_parameters import load_chain, masses_kg_m2, rotor_inertia_kg_m2
from eps_hil.physics.model import Model, load_model
from eps_hil.rig.assumed_chain import assumed_chain
from eps_hil.rig.config import REFERENCE_CHAIN

MODEL = load_model(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")


def test_the_reference_rig_has_the_reference_chain() -> None:
    assert assumed_chain(MODEL) == load_chain(REFERENCE_CHAIN)


@pytest.mark.parametrize(
    "model",
    [
        replace(MODEL, belt_ratio=1.0),
        replace(MODEL, rack_to_rotor_ratio_rad_per_m=1000.0),
        replace(MODEL, inertia_kg_m2=1e-6),
    ],
)
def test_a_lighter_rig_has_lighter_masses(model: Model) -> None:
    """A diagnosis ended with "use smaller masses", in a file that nobody gave."""
    chain = assumed_chain(model)
    others = masses_kg_m2(model, chain)
    left = rotor_inertia_kg_m2(model, chain)
    assert left + others == pytest.approx(model.inertia_kg_m2)
    assert left > 0.09 * model.inertia_kg_m2
    assert chain.rack_mass_kg / chain.ball_nut_inertia_kg_m2 == pytest.approx(
        load_chain(REFERENCE_CHAIN).rack_mass_kg
        / load_chain(REFERENCE_CHAIN).ball_nut_inertia_kg_m2
    )


def test_a_rotor_that_was_measured_stays() -> None:
    given = replace(load_chain(REFERENCE_CHAIN), rotor_inertia_kg_m2=1e-3)
    assert assumed_chain(MODEL, given) is given
