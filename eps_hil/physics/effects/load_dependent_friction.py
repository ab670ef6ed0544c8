"""Friction that grows with the rack force, the same in both directions (eq. 3, kr)."""

from collections.abc import Mapping
from dataclasses import replace

from eps_hil.physics.effects.effect import Effect, Kind, Parameter, Probe, Slot
from eps_hil.physics.model import Model


def _change(model: Model, values: Mapping[str, float]) -> Model:
    gain, friction = values["gain_nm_per_n"], model.friction
    return replace(
        model,
        friction=replace(
            friction,
            load_pos_nm_per_n=friction.load_pos_nm_per_n + gain,
            load_neg_nm_per_n=friction.load_neg_nm_per_n + gain,
        ),
    )


def _none_at_all(model: Model) -> float:
    """Friction does not fall with the load: a rack force that pushes rubs, or does not."""
    return -min(model.friction.load_pos_nm_per_n, model.friction.load_neg_nm_per_n)


EFFECT = Effect(
    id="load_dependent_friction",
    title="Load-dependent friction",
    kind=Kind.STRUCTURE,
    slot=Slot.MODEL,
    equation="T_fs += gain · |F|",
    parameters=(Parameter("gain_nm_per_n", "Nm/N", -2e-4, 2e-4, "friction torque per rack force"),),
    sentence="Friction grows with rack force by {gain_nm_per_n:.3g} Nm/N more than the model says.",
    sentence_negative="Friction grows with rack force by {gain_nm_per_n:.3g} Nm/N less than "
    "the model says.",
    twins={
        "coulomb_level": "constant speed at several preloads: only load friction changes",
        "rack_ratio": "both directions at one preload: friction changes sign, load does not",
    },
    change=_change,
    probe=Probe("gain_nm_per_n", 0.0, 1e-6, lowest=_none_at_all),
)
