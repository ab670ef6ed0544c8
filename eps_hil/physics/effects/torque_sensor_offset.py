"""A constant error of the torsion-bar torque."""

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot


@kernel
def _torque_nm(p: Floats, _s: Floats, _u: Instant, torque: float) -> float:
    return torque - p[0]


@kernel
def _told_nm(p: Floats, _s: Floats, _u: Instant, true: float) -> float:
    return true + p[0]


EFFECT = Effect(
    id="torque_sensor_offset",
    title="Torque sensor offset",
    kind=Kind.INSTRUMENT,
    slot=Slot.SENSOR,
    equation="T_sen = reported − offset",
    parameters=(
        Parameter("offset_nm", "Nm", -3.0, 3.0, "reported less true torque, at the column"),
    ),
    sentence="The torque sensor reads {offset_nm:.3g} Nm too much.",
    sentence_negative="The torque sensor reads {offset_nm:.3g} Nm too little.",
    twins={
        "motor_torque_offset": "hands off while the rotor moves: this sensor then reads its offset",
        "friction_asymmetry": "hands off while the rotor moves: an offset is still read",
    },
    kernel=_torque_nm,
    told=_told_nm,
    probe=Probe("offset_nm", 0.0, 0.02),
)
