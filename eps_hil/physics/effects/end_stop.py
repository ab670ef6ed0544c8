"""The rack's end stops: a stiff spring beyond a position on either side."""

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
)


@kernel
def _torque_nm(p: Floats, _s: Floats, u: Instant, torque: float) -> float:
    beyond = abs(u.position_m) - p[0]
    if beyond <= 0.0:
        return torque
    return torque + math.copysign(p[1] * beyond, u.position_m) / u.ratio_rad_per_m


EFFECT = Effect(
    id="end_stop",
    title="End stop",
    kind=Kind.STRUCTURE,
    slot=Slot.TORQUE,
    equation="F += stiffness · (|x| − position) · sign(x) beyond the position",
    parameters=(
        Parameter("position_m", "m", 0.001, 0.2, "rack position where the stop begins"),
        Parameter("stiffness_n_per_m", "N/m", 0.0, 1e9, "stiffness at the rack"),
    ),
    sentence="Beyond ±{position_m:.4g} m the rack meets a stop of {stiffness_n_per_m:.3g} N/m.",
    twins={"position_torque": "drive into the stop slowly, twice"},
    mass=Mass.RACK,
    kernel=_torque_nm,
    probe=Probe("stiffness_n_per_m", 0.0, 1e4, scan="position_m"),
)
