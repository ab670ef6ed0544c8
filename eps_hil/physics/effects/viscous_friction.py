"""Drag in proportion to speed, the same in both directions."""

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot
from eps_hil.physics.model import Model


@kernel
def _torque_nm(p: Floats, _s: Floats, u: Instant, torque: float) -> float:
    return torque + p[0] * u.speed_rad_s


def _none_at_all(model: Model) -> float:
    """Drag does not drive: all there is in a direction is the least that can be missing."""
    held = sum(
        float(entry["coefficient_nm_s_per_rad"])
        for entry in model.effects
        if entry["effect"] == "viscous_friction"
    )
    friction = model.friction
    least = min(friction.viscous_pos_nm_s_per_rad, friction.viscous_neg_nm_s_per_rad)
    return -max(least + held, 0.0)


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
    probe=Probe("coefficient_nm_s_per_rad", 0.0, 1e-4, lowest=_none_at_all),
)
