"""Findings of the axis in its own units: newtons and metres, the rotor's scale undone."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eps_hil.axis.augment import Augmented
from eps_hil.axis.emps import ARM_M
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Effect

_AXIS: Mapping[str, tuple[str, float]] = {
    "Nm s²/rad²": ("N s²/m²", ARM_M**-3),
    "Nm s/rad": ("N s/m", ARM_M**-2),
    "Nm/rad": ("N/m", ARM_M**-2),
    "rad/s": ("m/s", ARM_M),
    "Nm": ("N", 1.0 / ARM_M),
}
"""Unit at the rotor -> unit at the axis, and the factor; the longer first, as texts are replaced.
"""
_SUFFIX = {
    "_nm_s2_per_rad2": "_n_s2_per_m2",
    "_nm_s_per_rad": "_n_s_per_m",
    "_nm_per_rad": "_n_per_m",
    "_rad_s": "_m_s",
    "_nm": "_n",
}


def findings(augmented: Augmented, without: Sequence[Mapping[str, float]]) -> list[Any]:
    """One entry an effect, strongest first; ``without``: the held-out figures if it is left out."""
    found = []
    for k, entry in enumerate(augmented.fit.entries):
        effect = catalogue()[str(entry["effect"])]
        found.append(
            {
                "effect": effect.id,
                "kind": str(effect.kind),
                "equation": effect.equation,
                "summary": _summary(effect, entry),
                "parameters": _parameters(augmented, k, effect),
                "judging_part_energy_rise": augmented.losses[k],
                "heldout_without_it": dict(without[k]),
            }
        )
    return sorted(found, key=lambda one: -one["judging_part_energy_rise"])


def _summary(effect: Effect, entry: Mapping[str, Any]) -> str:
    if "order" in entry:
        pitch_mm = 2e3 * np.pi * ARM_M / entry["order"]
        return (
            f"A force of {entry['amplitude_nm'] / ARM_M:.3g} N repeats every {pitch_mm:.3f} mm "
            "of travel."
        )
    text, values = effect.wording(entry)
    for parameter in effect.parameters:
        if parameter.unit in _AXIS and parameter.name in values:
            values[parameter.name] *= _AXIS[parameter.unit][1]
    for unit, (other, _) in _AXIS.items():
        text = text.replace(f"}} {unit}", f"}} {other}")
    return text.format(**values)


def _parameters(augmented: Augmented, k: int, effect: Effect) -> dict[str, Any]:
    entry, fit = augmented.fit.entries[k], augmented.fit
    result: dict[str, Any] = {}
    for parameter in effect.parameters:
        if parameter.name not in entry:
            continue
        value = entry[parameter.name]
        if parameter.name == "curve":
            curve = [[x, torque / ARM_M] for x, torque in value]
            result["curve"] = {"value": curve, "unit": "m, N", "ci95": None}
            continue
        unit, factor = _AXIS.get(parameter.unit, (parameter.unit, 1.0))
        if (k, parameter.name) not in fit.names:
            continue
        half = fit.half_width[k, parameter.name]
        interval = [(value - half) * factor, (value + half) * factor]
        name = _renamed(parameter.name)
        result[name] = {"value": value * factor, "unit": unit, "ci95": interval}
        if name == "order":
            turn = 2 * np.pi * ARM_M
            ends = [turn / (value + half), turn / (value - half)]
            result["pitch_m"] = {"value": turn / value, "unit": "m", "ci95": ends}
            del result["order"]
    return result


def _renamed(name: str) -> str:
    for rotor, axis in _SUFFIX.items():
        if name.endswith(rotor):
            return name.removesuffix(rotor) + axis
    return name
