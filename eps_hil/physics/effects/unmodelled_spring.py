"""A spring on the rotor (or the rack) that the model does not have: a boot, a hose, a cable."""

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot


@kernel
def _torque_nm(p: Floats, _s: Floats, u: Instant, torque: float) -> float:
    return torque + p[0] * (u.angle_rad - p[1])


EFFECT = Effect(
    id="unmodelled_spring",
    title="Unmodelled spring",
    kind=Kind.STRUCTURE,
    slot=Slot.TORQUE,
    equation="stiffness · (φ − middle)",
    parameters=(
        Parameter("stiffness_nm_per_rad", "Nm/rad", -0.1, 0.1, "stiffness at the rotor"),
        Parameter("middle_rad", "rad", -1e6, 1e6, "rotor angle without a torque", 0.0),
    ),
    sentence="A spring of {stiffness_nm_per_rad:.3g} Nm/rad pulls the rotor to the middle.",
    sentence_negative="A spring of {stiffness_nm_per_rad:.3g} Nm/rad pushes the rotor out of "
    "the middle.",
    twins={"position_torque": "slow passes over the whole travel"},
    kernel=_torque_nm,
    probe=Probe("stiffness_nm_per_rad", 0.0, 1e-4, scan="middle_rad"),
)
