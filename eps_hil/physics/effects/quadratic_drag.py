"""Drag with the square of the speed: churning grease or oil, windage."""

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot


@kernel
def _torque_nm(p: Floats, _s: Floats, u: Instant, torque: float) -> float:
    return torque + p[0] * u.speed_rad_s * abs(u.speed_rad_s)


EFFECT = Effect(
    id="quadratic_drag",
    title="Quadratic drag",
    kind=Kind.STRUCTURE,
    slot=Slot.TORQUE,
    equation="+ coefficient · ω·|ω|",
    parameters=(
        Parameter("coefficient_nm_s2_per_rad2", "Nm s²/rad²", -1e-4, 1e-4, "drag per speed²"),
    ),
    sentence="A drag of {coefficient_nm_s2_per_rad2:.3g} Nm s²/rad² with the square of speed is "
    "missing.",
    sentence_negative="Drag with the square of speed is {coefficient_nm_s2_per_rad2:.3g} Nm "
    "s²/rad² less than the model says.",
    twins={"viscous_friction": "a sweep to at least twice the speed"},
    kernel=_torque_nm,
    probe=Probe("coefficient_nm_s2_per_rad2", 0.0, 1e-6, one_sided=True),
)
