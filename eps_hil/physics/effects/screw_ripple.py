"""Torque that repeats with every turn of the ball nut: pitch error, recirculation, a bent screw."""

import math

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import (
    Effect,
    Floats,
    Instant,
    Kind,
    Mass,
    Parameter,
    Probe,
    Slot,
    resolved,
)


@kernel
def _torque_nm(p: Floats, _s: Floats, u: Instant, torque: float) -> float:
    share = resolved(p[2] * u.speed_rad_s / p[3])
    return torque + share * p[0] * math.sin(p[2] * u.angle_rad / p[3] + p[1])


EFFECT = Effect(
    id="screw_ripple",
    title="Ball-screw torque ripple",
    kind=Kind.STRUCTURE,
    slot=Slot.TORQUE,
    equation="amplitude · sin(harmonic·φ/i_be + phase)",
    parameters=(
        Parameter("amplitude_nm", "Nm", 0.0, 0.5, "amplitude"),
        Parameter("phase_rad", "rad", -math.pi, math.pi, "phase at rotor angle zero"),
        Parameter("harmonic", "1", 1.0, 8.0, "multiple of the ball nut's turn", 1.0),
        Parameter("belt_ratio", "1", 1e-6, 1e6, "i_be; the model file's own", math.nan),
    ),
    sentence="A torque of {amplitude_nm:.3g} Nm repeats with every turn of the ball nut.",
    twins={"cogging_torque": "orders that belt ratio and pole pairs make equal: another gear"},
    mass=Mass.NUT,
    kernel=_torque_nm,
    probe=Probe("amplitude_nm", 0.0, 5e-3, phase="phase_rad"),
)
