"""Shaft torque that comes later than the file says: dead time or lag between report and shaft."""

from collections.abc import Mapping
from dataclasses import replace

from eps_hil.physics.effects.effect import Effect, Kind, Parameter, Probe, Slot
from eps_hil.physics.model import Model


def _change(model: Model, values: Mapping[str, float]) -> Model:
    delays = model.delays_s
    return replace(
        model, delays_s=replace(delays, motor_torque=delays.motor_torque - values["delay_s"])
    )


EFFECT = Effect(
    id="motor_torque_delay",
    kind=Kind.INSTRUMENT,
    slot=Slot.MODEL,
    equation="T_em(t) on the shaft = reported for t − delay",
    parameters=(Parameter("delay_s", "s", -0.05, 0.1, "shaft torque later than reported"),),
    sentence="The torque reaches the shaft {delay_s:.3g} s later than the file says.",
    sentence_negative="The torque reaches the shaft {delay_s:.3g} s earlier than the file says.",
    twins={"speed_sensor_delay": "a third signal with a known clock (load cell, rack position)"},
    change=_change,
    probe=Probe("delay_s", 0.0, 2e-4, least=0.75e-3),
)
