"""More (or less) friction around one rack position: wear on centre, a tight spot."""

import math

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot


@kernel
def _level_nm(p: Floats, _s: Floats, u: Instant, level: float) -> float:
    ratio = (u.position_m - p[1]) / p[2]
    return level + p[0] * math.exp(-ratio * ratio)


EFFECT = Effect(
    id="position_dependent_friction",
    title="Position-dependent friction",
    kind=Kind.STRUCTURE,
    slot=Slot.LEVEL,
    equation="T_fs += level · exp(−((x − centre)/width)²)",
    parameters=(
        Parameter("level_nm", "Nm", -0.5, 0.5, "extra friction at the centre of the region"),
        Parameter("centre_m", "m", -100.0, 100.0, "rack position of the region", 0.0),
        Parameter("width_m", "m", 1e-6, 100.0, "half width where 1/e is left"),
    ),
    sentence="Around rack position {centre_m:.4g} m, over ±{width_m:.3g} m, friction is "
    "{level_nm:.3g} Nm higher.",
    sentence_negative="Around rack position {centre_m:.4g} m, over ±{width_m:.3g} m, "
    "friction is {level_nm:.3g} Nm lower.",
    twins={
        "friction_warmup": "pass the same positions again later: a place stays, warming does not",
        "position_torque": "pass in both directions: friction changes sign, a static torque not",
    },
    kernel=_level_nm,
    probe=Probe("level_nm", 0.0, 0.01, scan="centre_m"),
)
