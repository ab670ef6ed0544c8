"""Whether what guard and gates judge by comes in the unit and from the shaft that they believe.

A torsion bar that counts a twentieth never reads as a hand in the wheel, and a load cell that does
ends no cell of a programme. So a scale of the mapping
must be the one of the unit that the database gives the signal, or of another shaft of the gear.
"""

import math
from typing import Any

from eps_hil.bus import units
from eps_hil.bus.config import BusSetup
from eps_hil.bus.database import find_message, load_database
from eps_hil.bus.mapping import SignalMapping, SignalSource, load_mapping
from eps_hil.errors import InputError
from eps_hil.physics.model import Model
from eps_hil.signals import CANONICAL

JUDGED = (
    "motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad",
    "rack_position_m", "rack_force_n",
)  # fmt: skip
_SAME = 0.01
"""By so much a scale may differ from what unit and gear say."""
_RAW = frozenset({"current", "voltage"})
"""Quantities of a sensor's own output, for which only its data sheet knows the scale."""


def scale_problem(
    name: str, source: SignalSource, database: Any, model: Model
) -> tuple[str, str] | None:
    """(problem, remedy) of the scale of signal ``name``; None where it may be right.

    None as well where the database has no known unit, and for a torque by its current.
    """
    if name not in JUDGED or source.message is None or source.torque_constant_nm_per_a is not None:
        return None
    message = find_message(database, source.message)
    signal = message and next((one for one in message.signals if one.name == source.signal), None)
    if signal and units.ambiguous(signal.unit):
        problem = f"{signal.name} is in {signal.unit}, which may be milli or mega"
        return problem, f"write m{signal.unit.strip()[1:]} in the database if it is milli"
    found = units.known(signal.unit) if signal else None
    if signal is None or found is None or found[0] in _RAW:
        return None
    quantity, factor = found
    wanted = CANONICAL[name].unit
    likely = [factor * each for each in _shafts(name, quantity, model)]
    if not likely:
        return (
            f"{signal.name} is in {signal.unit} ({quantity})",
            f"{wanted} was expected: another signal?",
        )
    if any(abs(abs(source.scale) - each) <= _SAME * each for each in likely):
        return None
    sign = math.copysign(1.0, source.scale)
    said = " or ".join(f"{sign * each:.7g}" for each in likely)
    return (
        f"{signal.name} is in {signal.unit}, scale is {source.scale:g}",
        f"to {wanted} it is {said}; mend the unit in the database if that is wrong",
    )


def _shafts(name: str, quantity: str, model: Model) -> tuple[float, ...]:
    """Canonical SI value per SI value of ``quantity``, at the rotor, at the pinion."""
    pinion, rotor = model.pinion_ratio_rad_per_m, model.rack_to_rotor_ratio_rad_per_m
    gear = abs(rotor / pinion)
    return {
        ("motor_torque_nm", "torque"): (1.0, 1.0 / gear),
        ("torque_sensor_nm", "torque"): (1.0,),
        ("motor_speed_rad_s", "angular speed"): (1.0, gear),
        ("motor_angle_rad", "angle"): (1.0, gear),
        ("motor_angle_rad", "length"): (abs(rotor),),
        ("rack_position_m", "length"): (1.0,),
        ("rack_force_n", "force"): (1.0,),
        ("rack_position_m", "angle"): (1.0 / abs(rotor), 1.0 / abs(pinion)),
    }.get((name, quantity), ())


def check_inputs(mapping: SignalMapping, database: Any, model: Model, file: object) -> None:
    """:class:`InputError` for the first signal of :data:`JUDGED` that has a wrong scale."""
    for name, source in mapping.signals.items():
        problem = scale_problem(name, source, database, model)
        if problem is not None:
            raise InputError(file, f"signals.{name}", *problem)


def check_mapped(setup: BusSetup, model: Model) -> None:
    """:func:`check_inputs` of the mapping and database that a configuration names."""
    mapping = load_mapping(setup.signals)
    check_inputs(mapping, load_database(setup.dbc, strict=mapping.strict), model, setup.signals)
