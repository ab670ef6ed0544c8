"""Static friction that grows while the contact rests and is lost again over a sliding distance.

The dwell that has grown is remembered as s[0] (0 to 1): towards 1 with the time constant while
resting, back to 0 with the distance slid. At rest means slower than ``REST_RAD_S``: creep of the
bristle, not sliding.
"""

import math

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot

REST_RAD_S = 0.05


@kernel
def _level_nm(p: Floats, s: Floats, _u: Instant, level: float) -> float:
    return level + p[0] * s[0]


@kernel
def _advance(p: Floats, s: Floats, u: Instant, dt: float) -> None:
    slid = abs(u.speed_rad_s) * dt / p[2]
    s[0] = s[0] * math.exp(-slid)
    if abs(u.speed_rad_s) < REST_RAD_S:
        s[0] += (1.0 - s[0]) * (1.0 - math.exp(-dt / p[1]))


EFFECT = Effect(
    id="breakaway_dwell",
    title="Static friction ageing (dwell)",
    kind=Kind.STRUCTURE,
    slot=Slot.LEVEL,
    equation="T_fs += level · (1 − exp(−t_rest/time)), lost over a sliding distance",
    parameters=(
        Parameter("level_nm", "Nm", 0.0, 0.5, "extra break-away torque after a long rest"),
        Parameter(
            "time_s", "s", 0.02, 100.0, "time over which it grows; rest is slower than 0.05 rad/s"
        ),
        Parameter("release_rad", "rad", 1e-3, 20.0, "rotor angle over which sliding loses it", 0.5),
    ),
    sentence="After a rest the drive breaks away {level_nm:.3g} Nm harder; this grows over "
    "{time_s:.3g} s of rest.",
    twins={"stribeck": "holds of 0.1 s to 30 s before each break-away"},
    kernel=_level_nm,
    at_reversal=True,
    advance=_advance,
    probe=Probe(
        "level_nm",
        0.0,
        0.01,
        tuple({"time_s": t, "release_rad": r} for t in (0.15, 0.6, 2.5) for r in (0.3, 2.0)),
    ),
)
