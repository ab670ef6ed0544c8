"""Friction that differs between the two directions of movement (eq. 3, k0+ against k0−)."""

from collections.abc import Mapping
from dataclasses import replace

from eps_hil.physics.effects.effect import Effect, Kind, Parameter, Probe, Slot
from eps_hil.physics.model import Model


def _change(model: Model, values: Mapping[str, float]) -> Model:
    half, friction = values["half_difference_nm"], model.friction
    return replace(
        model,
        friction=replace(
            friction,
            offset_pos_nm=friction.offset_pos_nm + half,
            offset_neg_nm=friction.offset_neg_nm - half,
        ),
    )


EFFECT = Effect(
    id="friction_asymmetry",
    title="Friction asymmetry",
    kind=Kind.STRUCTURE,
    slot=Slot.MODEL,
    equation="T_fs += sign(ω) · half_difference",
    parameters=(
        Parameter("half_difference_nm", "Nm", -0.3, 0.3, "half of positive less negative level"),
    ),
    sentence="Friction is 2 × {half_difference_nm:.3g} Nm higher turning positive than turning "
    "negative, beyond what the model says.",
    sentence_negative="Friction is 2 × {half_difference_nm:.3g} Nm higher turning negative than "
    "turning positive, beyond what the model says.",
    twins={
        "motor_torque_offset": "motor off while the rig moves the rack: an offset is still read",
        "torque_sensor_offset": "hands off while the rotor moves: an offset is still read",
    },
    change=_change,
    probe=Probe("half_difference_nm", 0.0, 2e-3),
)
