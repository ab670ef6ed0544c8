"""Drag in proportion to speed, the same in both directions."""

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot


@kernel
def _torque_nm(p: Floats, _s: Floats, u: Instant, torque: float) -> float:
    return torque + p[0] * u.speed_rad_s


EFFECT = Effect(
    id="viscous_friction",
    title="Viscous friction",
    kind=Kind.STRUCTURE,
    slot=Slot.TORQUE,
    equation="+ coefficient · ω",
    parameters=(Parameter("coefficient_nm_s_per_rad", "Nm s/rad", -5e-3, 2e-2, "drag per speed"),),
    sentence="A drag of {coefficient_nm_s_per_rad:.3g} Nm s/rad in proportion to speed is missing.",
    sentence_negative="Drag in proportion to speed is {coefficient_nm_s_per_rad:.3g} Nm "
    "s/rad less than the model says.",
    twins={"quadratic_drag": "a sweep to at least twice the speed"},
    kernel=_torque_nm,
    probe=Probe("coefficient_nm_s_per_rad", 0.0, 1e-4),
)
