"""Torque over the rotor angle that is there without current: cogging."""

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
    share = resolved(p[1] * u.speed_rad_s)
    return torque + share * p[0] * math.sin(p[1] * u.angle_rad + p[2])


EFFECT = Effect(
    id="cogging_torque",
    title="Cogging torque",
    kind=Kind.STRUCTURE,
    slot=Slot.TORQUE,
    equation="amplitude · sin(order·φ + phase)",
    parameters=(
        Parameter("amplitude_nm", "Nm", 0.0, 0.5, "amplitude"),
        Parameter("order", "1", 0.5, 200.0, "periods per turn of the rotor", per_turn=True),
        Parameter("phase_rad", "rad", -math.pi, math.pi, "phase at rotor angle zero"),
    ),
    sentence="A torque of {amplitude_nm:.3g} Nm repeats {order:.4g} times a rotor turn, whatever "
    "the motor torque: cogging.",
    twins={"torque_ripple": "slow passes at two different motor torques"},
    kernel=_torque_nm,
    probe=Probe("amplitude_nm", 0.0, 5e-3, phase="phase_rad", scan="order"),
)
