"""The inertia J_1m off by a factor (eq. 1b)."""

from collections.abc import Mapping
from dataclasses import replace

from eps_hil.physics.effects.effect import Effect, Kind, Parameter, Probe, Slot
from eps_hil.physics.model import Model


def _change(model: Model, values: Mapping[str, float]) -> Model:
    return replace(model, inertia_kg_m2=model.inertia_kg_m2 * values["scale"])


LEAST = 0.008
"""A chain of five masses moved a one-mass balance's by up to 0.7 % on development cases."""


EFFECT = Effect(
    id="inertia",
    title="Inertia error",
    kind=Kind.PARAMETER,
    slot=Slot.MODEL,
    equation="J · scale",
    parameters=(Parameter("scale", "1", 0.2, 5.0, "true per modelled inertia"),),
    sentence="The inertia is {scale:.3g} times what the model says.",
    twins={"motor_torque_gain": "standstill under a known load"},
    change=_change,
    probe=Probe("scale", 1.0, 5e-3, least=LEAST),
)
