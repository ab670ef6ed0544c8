"""The friction offsets of both directions off by one factor."""

from collections.abc import Mapping
from dataclasses import replace

from eps_hil.physics.effects.effect import Effect, Kind, Parameter, Probe, Slot
from eps_hil.physics.model import Model


def _change(model: Model, values: Mapping[str, float]) -> Model:
    scale, friction = values["scale"], model.friction
    return replace(
        model,
        friction=replace(
            friction,
            offset_pos_nm=friction.offset_pos_nm * scale,
            offset_neg_nm=friction.offset_neg_nm * scale,
        ),
    )


EFFECT = Effect(
    id="coulomb_level",
    title="Coulomb friction level",
    kind=Kind.PARAMETER,
    slot=Slot.MODEL,
    equation="k0± · scale",
    parameters=(Parameter("scale", "1", 0.05, 10.0, "true per modelled friction offsets"),),
    sentence="The friction offsets are {scale:.3g} times what the model says.",
    twins={"friction_warmup": "record the same manoeuvre again, cold and warm"},
    change=_change,
    probe=Probe("scale", 1.0, 0.01, least=0.01),
)
