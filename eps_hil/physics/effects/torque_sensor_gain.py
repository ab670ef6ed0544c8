"""A wrong scale of the torsion-bar torque."""

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot


@kernel
def _torque_nm(p: Floats, _s: Floats, _u: Instant, torque: float) -> float:
    return torque / p[0]


@kernel
def _told_nm(p: Floats, _s: Floats, _u: Instant, true: float) -> float:
    return true * p[0]


EFFECT = Effect(
    id="torque_sensor_gain",
    title="Torque sensor gain error",
    kind=Kind.INSTRUMENT,
    slot=Slot.SENSOR,
    stage=1,
    equation="reported = gain · true",
    parameters=(Parameter("gain", "1", 0.3, 3.0, "reported per true torque"),),
    sentence="The torque sensor reads {gain:.3g} times the true torque.",
    twins={"cardan_joint": "a turn of the pinion or more under a constant hand torque"},
    kernel=_torque_nm,
    told=_told_nm,
    probe=Probe("gain", 1.0, 5e-3, least=0.01),
)
