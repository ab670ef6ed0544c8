"""Play in the torque sensor: the reading follows the true torque only past a gap.

From the reported torque the true one is known only to within the gap. The kernel takes the play
back with a lead (s[0]) that runs to the half width in the direction in which the smoothed reading
(s[1]) moves; while the true torque crosses the gap this is off by up to the play. A diagnosis
measures the true torque by the torsion bar's twist instead (``diagnosis/direct/torsion_bar.py``).
"""

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Slot

_SMOOTH_S = 0.01
_LEAD = 10.0


@kernel
def _torque_nm(_p: Floats, s: Floats, _u: Instant, torque: float) -> float:
    return torque + s[0]


@kernel
def _advance(p: Floats, s: Floats, u: Instant, dt: float) -> None:
    if s[2] == 0.0:
        s[1], s[2] = u.torque_sensor_nm, 1.0
    before = s[1]
    s[1] += (u.torque_sensor_nm - s[1]) * dt / (dt + _SMOOTH_S)
    s[0] = min(max(s[0] + _LEAD * (s[1] - before), -p[0]), p[0])


@kernel
def _told_nm(p: Floats, s: Floats, _u: Instant, true: float) -> float:
    """Play: the reading is dragged along by the true torque; s[3] is where it stands."""
    s[3] = min(max(s[3], true - p[0]), true + p[0])
    return s[3]


EFFECT = Effect(
    id="torque_sensor_hysteresis",
    title="Torque sensor hysteresis",
    kind=Kind.INSTRUMENT,
    slot=Slot.SENSOR,
    stage=2,
    equation="reported follows true with play (half width)",
    parameters=(Parameter("play_nm", "Nm", 0.0, 2.0, "half width, at the column"),),
    sentence="The torque sensor has play of ±{play_nm:.3g} Nm.",
    twins={"backlash": "twist of the torsion bar (wheel angle less pinion angle) over its torque"},
    kernel=_torque_nm,
    told=_told_nm,
    advance=_advance,
)
