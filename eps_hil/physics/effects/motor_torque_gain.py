"""A wrong scale of the reported motor torque (torque constant)."""

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot


@kernel
def _torque_nm(p: Floats, _s: Floats, _u: Instant, torque: float) -> float:
    return torque * p[0]


EFFECT = Effect(
    id="motor_torque_gain",
    title="Torque constant error",
    kind=Kind.PARAMETER,
    slot=Slot.MOTOR,
    equation="true = gain · reported",
    parameters=(Parameter("gain", "1", 0.3, 3.0, "true per reported motor torque"),),
    sentence="The motor's torque is {gain:.3g} times what it reports.",
    twins={
        "rack_ratio": "a lever of known length and weight on the rotor",
        "inertia": "standstill under a known load",
    },
    kernel=_torque_nm,
    probe=Probe("gain", 1.0, 5e-3, least=0.004),
)
