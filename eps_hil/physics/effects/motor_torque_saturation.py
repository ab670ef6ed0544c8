"""A motor whose torque falls behind its current at high torque."""

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot


@kernel
def _torque_nm(p: Floats, _s: Floats, _u: Instant, torque: float) -> float:
    return torque / (1.0 + p[0] * torque * torque)


EFFECT = Effect(
    id="motor_torque_saturation",
    title="Motor torque saturation",
    kind=Kind.STRUCTURE,
    slot=Slot.MOTOR,
    stage=2,
    equation="T_em / (1 + curvature · T_em²)",
    parameters=(Parameter("curvature_per_nm2", "1/Nm²", -0.05, 1.0, "curvature"),),
    sentence="The motor gives less than it reports at high torque (curvature "
    "{curvature_per_nm2:.3g} /Nm²): saturation.",
    sentence_negative="The motor gives more than it reports at high torque (curvature "
    "-{curvature_per_nm2:.3g} /Nm²).",
    twins={"motor_torque_gain": "the same manoeuvre at half the torque"},
    kernel=_torque_nm,
    probe=Probe("curvature_per_nm2", 0.0, 0.01, one_sided=True),
)
