"""From the reported motor torque to that on the shaft: which parts of a model have a say in it."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from eps_hil.physics.effects.catalogue import catalogue, with_model_effects
from eps_hil.physics.effects.effect import Slot
from eps_hil.physics.model import Model

_NOT_OF_MOTOR = "inertia_kg_m2", "friction", "effects"


def what_it_follows(model: Model) -> tuple[Any, ...]:
    """What the torque on the motor's shaft follows from: not from friction, nor from inertia."""
    worked_in = with_model_effects(model)
    own = (one.name for one in fields(Model) if one.name not in _NOT_OF_MOTOR)
    acting = [one for one in worked_in.effects if _slot(one) in (Slot.POSITION, Slot.MOTOR)]
    return (*(getattr(worked_in, name) for name in own), *acting)


def _slot(entry: Mapping[str, Any]) -> Slot:
    effect = catalogue()[str(entry["effect"])]
    return effect.slot if effect.slot_of is None else effect.slot_of(entry)


def bends_motor_torque(entry: Mapping[str, Any]) -> bool:
    """Whether an effect does more to the motor's torque than to add a torque of its own."""
    effect = catalogue()[str(entry["effect"])]
    if _slot(entry) is not Slot.MOTOR:
        return False
    own = None if effect.probe is None else effect.probe.amplitude
    return all(one.name != own or one.dimensions != {"Nm": 1} for one in effect.parameters)


def follows_motor_torque(entry: Mapping[str, Any]) -> bool:
    """Whether an effect's own input is the motor's torque, beside what it acts on."""
    return any(
        "motor_torque" in str(one) or "motor_power" in str(one) for one in entry.get("inputs", ())
    )


def behind_lag(model: Model, cutoff_hz: float) -> float:
    """Share of the motor torque's noise variance, below a cutoff, that a lag before the shaft lets
    through.
    """
    lags = [e["delay_s"] for e in model.effects if e["effect"] == "motor_torque_delay"]
    bend = 2.0 * math.pi * cutoff_hz * sum(lags)
    return math.atan(bend) / bend if bend > 0.0 else 1.0
