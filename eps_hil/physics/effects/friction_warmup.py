"""Friction that falls (or rises) over minutes as grease and gear warm up."""

import math

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot


@kernel
def _level_nm(p: Floats, _s: Floats, u: Instant, level: float) -> float:
    return level * (1.0 + p[0] * math.exp(-u.time_s / p[1]))


EFFECT = Effect(
    id="friction_warmup",
    title="Friction warm-up",
    kind=Kind.STRUCTURE,
    slot=Slot.LEVEL_FACTOR,
    equation="T_fs · (1 + amplitude · exp(−t/time))",
    parameters=(
        Parameter("amplitude", "1", -0.9, 3.0, "relative excess at the start of each recording"),
        Parameter("time_s", "s", 1.0, 3000.0, "time over which it fades"),
    ),
    sentence="Friction starts {amplitude:.0%} higher and settles over {time_s:.3g} s.",
    sentence_negative="Friction starts {amplitude:.0%} lower and settles over {time_s:.3g} s.",
    twins={
        "position_dependent_friction": "pass the same positions again later",
        "coulomb_level": "record the same manoeuvre again, cold and warm",
    },
    kernel=_level_nm,
    over_time=True,
    probe=Probe(
        "amplitude", 0.0, 0.02, tuple({"time_s": t} for t in (8.0, 30.0, 120.0)), one_sided=True
    ),
)
