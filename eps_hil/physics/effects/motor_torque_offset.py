"""A constant error of the reported motor torque."""

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot


@kernel
def _torque_nm(p: Floats, _s: Floats, _u: Instant, torque: float) -> float:
    return torque + p[0]


EFFECT = Effect(
    id="motor_torque_offset",
    title="Motor torque offset",
    kind=Kind.INSTRUMENT,
    slot=Slot.MOTOR,
    stage=1,
    equation="T_em + offset",
    parameters=(Parameter("offset_nm", "Nm", -0.5, 0.5, "true less reported motor torque"),),
    sentence="The motor gives {offset_nm:.3g} Nm more than it reports.",
    sentence_negative="The motor gives {offset_nm:.3g} Nm less than it reports.",
    twins={
        "torque_sensor_offset": "hands off while the rotor moves: that sensor then reads zero",
        "friction_asymmetry": "motor off while the rig moves the rack: an offset is still read",
    },
    kernel=_torque_nm,
    probe=Probe("offset_nm", 0.0, 2e-3),
)
