"""What the page draws: traces by name, strip charts over time, and plots of one over another."""

from dataclasses import dataclass
from typing import Any

from eps_hil.signals import CANONICAL, PUBLISHED

ERROR = "rack_force_error_n"
"""Published estimate less load cell, of one physical instant."""
ESTIMATE, CELL, FRICTION = "rack_force_estimate_n", "rack_force_n", "friction_torque_nm"
POSITION, ANGLE, SPEED = "rack_position_m", "motor_angle_rad", "motor_speed_rad_s"


@dataclass(frozen=True, slots=True)
class Trace:
    """One quantity over time; ``colour`` numbers the page's palette."""

    name: str
    label: str
    unit: str
    colour: int


TRACES = (
    Trace(ESTIMATE, "estimate", "N", 0),
    Trace(CELL, "load cell", "N", 1),
    Trace(ERROR, "estimate − load cell", "N", 3),
    Trace("motor_torque_nm", "motor torque", "Nm", 0),
    Trace("torque_sensor_nm", "torsion-bar torque", "Nm", 1),
    Trace(SPEED, "rotor speed", CANONICAL[SPEED].unit, 2),
    Trace(FRICTION, "friction torque", "Nm", 4),
    Trace(POSITION, "rack position", "m", 2),
)
NAMES = tuple(trace.name for trace in TRACES)
"""In the order in which values travel."""
BALANCE = "torque_balance_n"
"""Residual of the torque balance as force at the rack; NaN where the rotor does not slide."""
MEASURED = tuple(name for name in CANONICAL if name not in PUBLISHED)
"""What a diagnosis reads of a bus."""
KEPT = (*NAMES, BALANCE, *(name for name in MEASURED if name not in NAMES))
"""All that is kept: what is drawn first, and what a map or a diagnosis needs beside it."""
AT_ONE_INSTANT = (POSITION, CELL, ESTIMATE, SPEED, FRICTION)
"""What plots of one quantity over another need, all at the same instants."""
STRIPS = (
    ("Rack force", (ESTIMATE, CELL)),
    ("Residual", (ERROR,)),
    ("Torques", ("motor_torque_nm", "torque_sensor_nm")),
    ("Rotor speed", (SPEED,)),
    ("Friction torque", (FRICTION,)),
    ("Rack position", (POSITION,)),
)
LOOPS = (
    ("Rack force over rack position", POSITION, (ESTIMATE, CELL)),
    ("Friction torque over rotor speed", SPEED, (FRICTION,)),
)


def layout() -> dict[str, Any]:
    """The same for the page's script."""
    return {
        "traces": [
            {"name": t.name, "label": t.label, "unit": t.unit, "colour": t.colour} for t in TRACES
        ],
        "instants": list(AT_ONE_INSTANT),
        "strips": [{"title": title, "traces": list(names)} for title, names in STRIPS],
        "loops": [{"title": title, "x": x, "y": list(y)} for title, x, y in LOOPS],
    }
