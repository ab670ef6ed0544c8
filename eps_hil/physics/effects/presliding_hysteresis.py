"""The bristle before sliding: another stiffness than the model's."""

from collections.abc import Mapping
from dataclasses import replace

from eps_hil.physics.effects.effect import OF_MODEL, Effect, Kind, Parameter, Probe, Slot
from eps_hil.physics.model import Model


def _change(model: Model, values: Mapping[str, float]) -> Model:
    sigma0 = values["sigma0_nm_per_rad"]
    return replace(model, friction=replace(model.friction, sigma0_nm_per_rad=sigma0))


EFFECT = Effect(
    id="presliding_hysteresis",
    title="Presliding hysteresis",
    kind=Kind.STRUCTURE,
    slot=Slot.MODEL,
    equation="ż = ω − |ω| σ0 z / T_fs with σ0 = sigma0",
    parameters=(
        Parameter("sigma0_nm_per_rad", "Nm/rad", 0.05, 500.0, "bristle stiffness at the rotor"),
    ),
    sentence="Before it slides the drive is a spring of {sigma0_nm_per_rad:.3g} Nm/rad, not what "
    "the model says.",
    twins={
        "backlash": "φ against x with a slow reversal: backlash shows a gap, presliding none",
        "stribeck": "reversals at several speeds",
    },
    change=_change,
    probe=Probe("sigma0_nm_per_rad", OF_MODEL, 0.1, least=0.1),
)
