"""The ratio from rack to rotor off: what the rack force is worth at the rotor; perhaps over x."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from eps_hil.physics.effects.effect import Effect, Floats, Kind, Parameter, Probe, Slot
from eps_hil.physics.model import Model


def _change(model: Model, values: Mapping[str, float]) -> Model:
    ratio = model.rack_to_rotor_ratio_rad_per_m * (1.0 + values["scale"])
    return replace(model, rack_to_rotor_ratio_rad_per_m=ratio)


def _words(values: Mapping[str, float]) -> str:
    if values.get("slope_per_m", 0.0) == values.get("bend_per_m2", 0.0) == 0.0:
        return _CONSTANT
    return _VARYING


_CONSTANT = "The ratio from rack to rotor is {scale:+.2%} off."
_VARYING = (
    "The ratio from rack to rotor varies over the rack position x: {scale:+.2%} off in the middle, "
    "and by {slope_per_m:.3g}/m · x + {bend_per_m2:.3g}/m² · x² beside it."
)


def local_share(values: Mapping[str, float], position_m: Floats) -> Floats:
    """Rotor ratio in the middle over the local dφ/dx, (n,): what a force at the rack is worth.

    φ = i·x·(1 + scale + slope·x + bend·x²), so dφ/dx = i·(1 + scale + 2·slope·x + 3·bend·x²).
    """
    middle = 1.0 + values["scale"]
    slope, bend = values.get("slope_per_m", 0.0), values.get("bend_per_m2", 0.0)
    local = middle + 2.0 * slope * position_m + 3.0 * bend * position_m**2
    return np.asarray(middle / local)


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
    sentence=_CONSTANT,
    words=_words,
    twins={
        "motor_torque_gain": "count rotor turns over a measured rack travel",
    },
    change=_change,
    probe=Probe("scale", 0.0, 2e-3, least=0.004),
)
