"""The ratio from rack to rotor off: what the rack force is worth at the rotor."""

from collections.abc import Mapping
from dataclasses import replace

from eps_hil.physics.effects.effect import Effect, Kind, Parameter, Probe, Slot
from eps_hil.physics.model import Model


def _change(model: Model, values: Mapping[str, float]) -> Model:
    ratio = model.rack_to_rotor_ratio_rad_per_m * (1.0 + values["scale"])
    return replace(model, rack_to_rotor_ratio_rad_per_m=ratio)


EFFECT = Effect(
    id="rack_ratio",
    kind=Kind.PARAMETER,
    slot=Slot.MODEL,
    equation="i_APA · (1 + scale)",
    parameters=(Parameter("scale", "1", -0.5, 1.0, "relative error of the ratio"),),
    sentence="The ratio from rack to rotor is {scale:+.2%} off.",
    twins={
        "motor_torque_gain": "count rotor turns over a measured rack travel",
    },
    change=_change,
    probe=Probe("scale", 0.0, 2e-3, least=0.004),
)
