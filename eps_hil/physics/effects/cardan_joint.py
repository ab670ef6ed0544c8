"""Unequal transmission of a cardan joint between the torsion bar and the pinion."""

import math

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot


@kernel
def _torque_nm(p: Floats, _s: Floats, u: Instant, torque: float) -> float:
    return torque * (1.0 + p[0] * math.cos(2.0 * u.pinion_rad + p[1]))


EFFECT = Effect(
    id="cardan_joint",
    title="Cardan joint error",
    kind=Kind.STRUCTURE,
    slot=Slot.SENSOR,
    stage=3,
    equation="T_sen · (1 + fraction · cos(2ψ + phase))",
    parameters=(
        Parameter("fraction", "1", 0.0, 0.5, "relative amplitude"),
        Parameter("phase_rad", "rad", -math.pi, math.pi, "phase at pinion angle zero"),
    ),
    sentence="What reaches the pinion of the torsion-bar torque swings by {fraction:.2%} twice a "
    "turn: a cardan joint.",
    twins={"torque_sensor_gain": "a turn of the pinion or more under a constant hand torque"},
    kernel=_torque_nm,
    probe=Probe("fraction", 0.0, 0.01, phase="phase_rad"),
)
