"""Ripple of the motor in proportion to its torque, six times per electrical turn."""

import math

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import (
    Effect,
    Floats,
    Instant,
    Kind,
    Parameter,
    Probe,
    Slot,
    resolved,
)


@kernel
def _torque_nm(p: Floats, _s: Floats, u: Instant, torque: float) -> float:
    share = resolved(6.0 * p[2] * u.speed_rad_s)
    return torque * (1.0 + share * p[0] * math.sin(6.0 * p[2] * u.angle_rad + p[1]))


EFFECT = Effect(
    id="torque_ripple",
    title="Motor torque ripple",
    kind=Kind.STRUCTURE,
    slot=Slot.MOTOR,
    stage=3,
    equation="T_em · (1 + fraction · sin(6·pole_pairs·φ + phase))",
    parameters=(
        Parameter("fraction", "1", 0.0, 0.5, "ripple per motor torque"),
        Parameter("phase_rad", "rad", -math.pi, math.pi, "phase at rotor angle zero"),
        Parameter("pole_pairs", "1", 1.0, 100.0, "the model file's own", math.nan),
    ),
    sentence="The motor's torque ripples by {fraction:.2%} six times an electrical turn.",
    twins={"cogging_torque": "slow passes at two different motor torques"},
    kernel=_torque_nm,
    probe=Probe("fraction", 0.0, 0.01, phase="phase_rad"),
)
