"""The ratio from rack to rotor off: what the rack force is worth at the rotor; perhaps over x."""

import math
from collections.abc import Mapping
from dataclasses import replace

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot
from eps_hil.physics.model import Model


def _change(model: Model, values: Mapping[str, float]) -> Model:
    ratio = model.rack_to_rotor_ratio_rad_per_m * (1.0 + values["scale"])
    return replace(model, rack_to_rotor_ratio_rad_per_m=ratio)


def _words(values: Mapping[str, float]) -> str:
    if values.get("slope_per_m", 0.0) == values.get("bend_per_m2", 0.0) == 0.0:
        return _CONSTANT
    return _VARYING


_CONSTANT = "The ratio from rack to rotor is {scale:+.2%} off."
_MOST, _STEPS = 3.0, 5
_VARYING = (
    "The ratio from rack to rotor varies over the rack position x: {scale:+.2%} off in the middle, "
    "and by {slope_per_m:.3g}/m · x + {bend_per_m2:.3g}/m² · x² beside it."
)


def _left(values: Mapping[str, float]) -> Mapping[str, float] | None:
    """What varies, once the middle's scale is in the model: φ = i_APA·x · (1 + a·x + b·x²)."""
    slope, bend = values["slope_per_m"], values["bend_per_m2"]
    if slope == bend == 0.0:
        return None
    middle = 1.0 + values["scale"]
    return {"scale": 0.0, "slope_per_m": slope / middle, "bend_per_m2": bend / middle}


@kernel
def _local(p: Floats, position_m: float) -> float:
    """dφ/dx over i_APA: what a torque at the rotor is worth at the rack, here over mid travel.

    A ratio that turns over is none: far beyond what was seen the polynomial is not believed.
    """
    local = 1.0 + (2.0 * p[1] + 3.0 * p[2] * position_m) * position_m
    return min(max(local, 1.0 / _MOST), _MOST)


@kernel
def _position_m(p: Floats, _s: Floats, _u: Instant, middle_m: float) -> float:
    """The rack's position x at which φ = i_APA·x · (1 + a·x + b·x²); Newton's method."""
    x = middle_m
    for _ in range(_STEPS):
        x -= (x * (1.0 + (p[1] + p[2] * x) * x) - middle_m) / _local(p, x)
        x = math.copysign(min(max(abs(x), abs(middle_m) / _MOST), _MOST * abs(middle_m)), middle_m)
    return x


@kernel
def _sensor_nm(p: Floats, _s: Floats, u: Instant, torque: float) -> float:
    return torque / _local(p, u.position_m)


@kernel
def _load_nm(p: Floats, _s: Floats, u: Instant, torque: float) -> float:
    return torque / _local(p, u.position_m)


EFFECT = Effect(
    id="rack_ratio",
    title="Gear ratio error",
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
    left=_left,
    elsewhere={
        Slot.POSITION: _position_m,
        Slot.SENSOR: _sensor_nm,
        Slot.LOAD: _load_nm,
    },
    stage=9,
    probe=Probe("scale", 0.0, 2e-3, least=0.004),
)
