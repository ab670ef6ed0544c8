"""Signals at one instant as a JSON object: what a file or a live stream tells plotting tools.

``{"eps_hil": {"rack_force_n": 312.5, ...}}``, which PlotJuggler shows as ``/eps_hil/rack_force_n``
and so on. JSON has no NaN: a signal without a good value is left out.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from eps_hil.signals import CANONICAL

TOPIC = "eps_hil"
LOOPS = {
    "load_cell": ("rack_position_m", "rack_force_n"),
    "estimate": ("rack_position_m", "rack_force_estimate_n"),
    "friction": ("motor_speed_rad_s", "friction_torque_nm"),
}
"""Plots of one signal over another: a tool wants both at the same instants, always."""
_MORE = {
    "valid": "1 where the estimate holds",
    "rack_force_error_n": "published estimate less load cell, of one physical instant [N]",
}


def row(values: Mapping[str, float]) -> dict[str, Any]:
    """One instant's object; the loops only where they have both values."""
    told: dict[str, Any] = {n: value for n, value in values.items() if math.isfinite(value)}
    loops = {
        name: {x: told[x], y: told[y]} for name, (x, y) in LOOPS.items() if x in told and y in told
    }
    return {**told, "loops": loops} if loops else told


def schema_of(names: Iterable[str], carriers: Mapping[str, str] | None = None) -> dict[str, Any]:
    """JSON schema of a row with these signals: what each is, in which unit, from which message."""
    about = {name: _about(name, (carriers or {}).get(name)) for name in names}
    loops = {name: pair for name, pair in LOOPS.items() if set(pair) <= set(about)}
    properties: dict[str, Any] = {n: {"type": "number", "description": t} for n, t in about.items()}
    if loops:
        properties["loops"] = {
            "type": "object",
            "description": "pairs of signals, at instants at which both are there",
            "properties": {
                name: {
                    "type": "object",
                    "properties": {one: {"type": "number"} for one in pair},
                    "required": list(pair),
                }
                for name, pair in loops.items()
            },
            "additionalProperties": False,
        }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"{TOPIC}.signals",
        "type": "object",
        "properties": properties,
    }


def _about(name: str, carrier: str | None) -> str:
    known = CANONICAL.get(name)
    text = f"{known.description} [{known.unit}]" if known else _MORE.get(name, name)
    return f"{text}, CAN message {carrier}" if carrier else text
