"""Speed and angle reported later than the model file says."""

from collections.abc import Mapping
from dataclasses import replace

from eps_hil.physics.effects.effect import Effect, Kind, Parameter, Probe, Slot
from eps_hil.physics.model import Model


def _change(model: Model, values: Mapping[str, float]) -> Model:
    late, delays = values["delay_s"], model.delays_s
    angle = None if delays.motor_angle is None else delays.motor_angle + late
    return replace(
        model,
        delays_s=replace(delays, motor_speed=delays.motor_speed + late, motor_angle=angle),
    )


EFFECT = Effect(
    id="speed_sensor_delay",
    title="Speed sensor delay",
    kind=Kind.INSTRUMENT,
    slot=Slot.MODEL,
    equation="ω(t), φ(t) reported at t + delay beyond the model file's",
    parameters=(Parameter("delay_s", "s", -0.05, 0.1, "further delay of speed and angle"),),
    sentence="Speed and angle are reported {delay_s:.3g} s later than the model file says.",
    sentence_negative="Speed and angle are reported {delay_s:.3g} s earlier than the model "
    "file says.",
    twins={"motor_torque_delay": "a third signal with a known clock (load cell, rack position)"},
    change=_change,
    probe=Probe("delay_s", 0.0, 2e-4, least=0.3e-3),
)
