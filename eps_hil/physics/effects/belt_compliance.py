"""An elastic belt: rotor and ball nut as two masses with a spring and a damper between them."""

from collections.abc import Mapping
from typing import Any

from eps_hil.physics.effects.effect import Effect, Joint, Kind, Parameter, Slot


def _joint(joint: Joint, values: Mapping[str, Any]) -> Joint:
    return joint._replace(
        stiffness_nm_per_rad=values["stiffness_nm_per_rad"],
        damping_nm_s_per_rad=values["damping_nm_s_per_rad"],
    )


EFFECT = Effect(
    id="belt_compliance",
    title="Belt compliance",
    kind=Kind.STRUCTURE,
    slot=Slot.JOINT,
    equation="two masses joined by stiffness · Δφ + damping · Δω",
    parameters=(
        Parameter("stiffness_nm_per_rad", "Nm/rad", 0.1, 1e4, "stiffness at the rotor"),
        Parameter("damping_nm_s_per_rad", "Nm s/rad", 0.0, 1.0, "damping at the rotor", 5e-3),
    ),
    sentence="The belt gives: {stiffness_nm_per_rad:.3g} Nm/rad between rotor and ball nut.",
    twins={"inertia": "a sweep through the belt's resonance"},
    joint=_joint,
)
