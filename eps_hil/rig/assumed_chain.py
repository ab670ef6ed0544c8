"""The chain behind a model file of which nobody gave one: for what a rig would show."""

from dataclasses import replace

from eps_hil.physics.chain_parameters import ChainParameters, load_chain, masses_kg_m2
from eps_hil.physics.model import Model
from eps_hil.rig.config import REFERENCE_CHAIN

_MOST = 0.9
"""Share of J_1m (eq. 1b) that nut, rack and road wheels may have of a real rotor's."""
_ASSUMED = 0.5
"""The same where the given masses are of a heavier gear, and only their shares are kept."""


def assumed_chain(model: Model, given: ChainParameters | None = None) -> ChainParameters:
    """``given``, or the reference chain; with lighter masses where the model's J_1m has no room.

    A rotor inertia that is ``given`` stays, and is checked against the model where it is used.
    """
    chain = given or load_chain(REFERENCE_CHAIN)
    if chain.rotor_inertia_kg_m2 is not None:
        return chain
    others = masses_kg_m2(model, chain)
    if others <= _MOST * model.inertia_kg_m2:
        return chain
    share = _ASSUMED * model.inertia_kg_m2 / others
    return replace(
        chain,
        ball_nut_inertia_kg_m2=share * chain.ball_nut_inertia_kg_m2,
        rack_mass_kg=share * chain.rack_mass_kg,
        road_wheel_inertia_kg_m2=share * chain.road_wheel_inertia_kg_m2,
    )
