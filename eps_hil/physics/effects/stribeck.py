"""Friction that falls from break-away to sliding (Stribeck); eq. 2b without its constant part."""

import math

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot


@kernel
def _level_nm(p: Floats, _s: Floats, u: Instant, level: float) -> float:
    ratio = u.speed_rad_s / p[1]
    return level + p[0] * math.exp(-ratio * ratio)


EFFECT = Effect(
    id="stribeck",
    title="Stribeck friction",
    kind=Kind.STRUCTURE,
    slot=Slot.LEVEL,
    equation="T_fs += level · exp(−(ω/speed)²)",
    parameters=(
        Parameter("level_nm", "Nm", -0.5, 1.0, "rise of friction towards standstill"),
        Parameter("speed_rad_s", "rad/s", 0.5, 200.0, "speed over which the rise fades"),
    ),
    sentence="Friction is {level_nm:.3g} Nm higher near standstill and falls over {speed_rad_s:.3g}"
    " rad/s: a Stribeck effect that the model does not have.",
    sentence_negative="Friction is {level_nm:.3g} Nm lower near standstill and rises over "
    "{speed_rad_s:.3g} rad/s: it bends with speed, the other way than a Stribeck effect does.",
    twins={
        "breakaway_dwell": "holds of 0.1 s to 30 s before each break-away: dwell friction grows "
        "with the hold, Stribeck friction does not",
        "presliding_hysteresis": "slow reversals at several speeds below and above the Stribeck "
        "speed",
    },
    kernel=_level_nm,
    at_reversal=True,
    probe=Probe(
        "level_nm",
        0.0,
        0.01,
        tuple({"speed_rad_s": v} for v in (2.0, 5.0, 12.0, 30.0)),
        one_sided=True,
    ),
)
