"""The ratio from rack to rotor off: what the rack force is worth at the rotor; perhaps over x."""

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
    equation="i_APA · (1 + scale); φ = i_APA·x · (1 + scale + slope·x + bend·x²) where it varies",
    parameters=(
        Parameter(
            "scale", "1", -0.5, 1.0, "true ratio less the file's, over the file's, in the middle"
        ),
        Parameter("slope_per_m", "1/m", -20.0, 20.0, "its change with rack position", 0.0),
        Parameter("bend_per_m2", "1/m²", -2e3, 2e3, "its change with position squared", 0.0),
    ),
    sentence="The ratio from rack to rotor is {scale:+.2%} off.",
    twins={
        "motor_torque_gain": "count rotor turns over a measured rack travel",
    },
    change=_change,
    probe=Probe("scale", 0.0, 2e-3, least=0.004),
)
