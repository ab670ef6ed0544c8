"""Play in the torque sensor: the reading follows the true torque only past a gap.

From the reported torque the true one is known only to within the gap: s[0] follows the reading
with the play turned round (it leads by the half width in the direction of the last change).
"""

from eps_hil.compiled import njit
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Slot


@njit
def _torque_nm(p: Floats, s: Floats, _u: Instant, torque: float) -> float:
    change = torque - s[1] if s[2] > 0.0 else 0.0
    lead = min(max(s[0] + 2.0 * change, -p[0]), p[0])
    s[0], s[1], s[2] = lead, torque, 1.0
    return torque + lead


EFFECT = Effect(
    id="torque_sensor_hysteresis",
    kind=Kind.INSTRUMENT,
    slot=Slot.SENSOR,
    equation="reported follows true with play (half width)",
    parameters=(Parameter("play_nm", "Nm", 0.0, 1.0, "half width, at the column"),),
    sentence="The torque sensor has play of ±{play_nm:.3g} Nm.",
    twins={"backlash": "twist of the torsion bar (wheel angle less pinion angle) over its torque"},
    kernel=_torque_nm,
    simulated=False,
)
