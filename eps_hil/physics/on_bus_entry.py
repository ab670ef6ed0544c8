"""Entries of a rig's model file that change nothing but what the rig reports."""

import math
from collections.abc import Mapping
from typing import Any

from eps_hil.physics.effects.effect import Parameter
from eps_hil.unit_words import spaced


def read(
    name: str, parameter: Parameter, default: str | None, entry: Mapping[str, Any]
) -> dict[str, Any]:
    """``{parameter: number, "signal": canonical name or None}``; ``ValueError`` if wrong."""
    for key in entry:
        if key not in ("effect", "signal", parameter.name):
            raise ValueError(f"{name} has no parameter '{key}'; it has {parameter.name}, signal")
    value = entry.get(parameter.name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{name}.{parameter.name} is {value!r}, a number was expected")
    if not parameter.lower <= value <= parameter.upper:
        raise ValueError(
            f"{name}.{parameter.name} is {value:g}, expected {parameter.lower:g} to "
            f"{parameter.upper:g}{spaced(parameter.unit)}"
        )
    signal = entry.get("signal", default)
    if signal is not None and not isinstance(signal, str):
        raise ValueError(f"{name}.signal is {signal!r}, a canonical signal name was expected")
    return {parameter.name: float(value), "signal": signal}
