"""Play between rotor and rack: a dead zone in which the rotor turns and the rack does not."""

from collections.abc import Mapping
from typing import Any

from eps_hil.physics.effects.effect import Effect, Joint, Kind, Parameter, Slot


def _joint(joint: Joint, values: Mapping[str, Any]) -> Joint:
    return joint._replace(gap_rad=values["gap_rad"])


EFFECT = Effect(
    id="backlash",
    title="Backlash between rotor and rack",
    kind=Kind.STRUCTURE,
    slot=Slot.JOINT,
    equation="torque passes only when |φ − i_APA·x| has closed the gap: "
    "dead zone of width gap in the joint",
    parameters=(Parameter("gap_rad", "rad", 0.0, 5.0, "whole width of the gap at the rotor"),),
    sentence="Between rotor and rack there is play of {gap_rad:.3g} rad.",
    twins={
        "presliding_hysteresis": "φ against rack position through slow reversals",
        "torque_sensor_hysteresis": "φ against rack position through slow reversals",
    },
    joint=_joint,
)
