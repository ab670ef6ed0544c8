"""Findings of the axis in its own units: newtons and metres, the rotor's scale undone."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eps_hil.axis.emps import ARM_M
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Effect
from eps_hil.physics.model import Model

_AXIS: Mapping[str, tuple[str, float]] = {
    "Nm s²/rad²": ("N s²/m²", ARM_M**-3),
    "Nm s/rad": ("N s/m", ARM_M**-2),
    "Nm/rad": ("N/m", ARM_M**-2),
    "rad/s": ("m/s", ARM_M),
    "Nm": ("N", 1.0 / ARM_M),
}
"""Unit at the rotor -> unit at the axis, and the factor; the longer first, as texts are replaced.
"""
_SAME_ORDER = 0.05
_SUFFIX = {
    "_nm_s2_per_rad2": "_n_s2_per_m2",
    "_nm_s_per_rad": "_n_s_per_m",
    "_nm_per_rad": "_n_per_m",
    "_rad_s": "_m_s",
    "_nm": "_n",
}


def entries_of(finding: Mapping[str, Any], model: Model) -> list[Mapping[str, Any]]:
    """The entries of the written model that a finding of the diagnosis stands for."""
    name = "empirical" if finding["effect"] == "unknown" else finding["effect"]
    order = finding.get("parameters", {}).get("order", {}).get("value")
    return [
        entry
        for entry in model.effects
        if entry["effect"] == name
        and (order is None or abs(float(entry["order"]) - order) < _SAME_ORDER)
    ]


def findings(
    told: Sequence[Mapping[str, Any]],
    model: Model,
    without: Sequence[Mapping[str, float]],
) -> list[dict[str, Any]]:
    """The diagnosis' findings in units of the axis, as it ranks them.

    ``without``: for each the figures on the held-out record if it is left out of ``model``. What
    the catalogue has no name for stays in units of the notional rotor.
    """
    found = []
    for finding, figures in zip(told, without, strict=True):
        one = {
            key: finding[key]
            for key in ("effect", "kind", "confidence", "equation", "summary", "confusable_with")
            if key in finding
        }
        if finding["effect"] in catalogue():
            (entry, *_) = entries_of(finding, model)
            effect = catalogue()[finding["effect"]]
            one["summary"] = _summary(effect, entry)
            one["parameters"] = _parameters(finding["parameters"], effect)
        else:
            one["parameters"] = {}
            one["model"] = finding.get("model")
        found.append({**one, "heldout_without_it": dict(figures)})
    return found


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


def _parameters(told: Mapping[str, Any], effect: Effect) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for parameter in effect.parameters:
        if parameter.name not in told:
            continue
        value, ends = told[parameter.name]["value"], told[parameter.name]["ci95"]
        if parameter.name == "curve":
            curve = [[x, torque / ARM_M] for x, torque in value]
            result["curve"] = {"value": curve, "unit": "m, N", "ci95": None}
        elif parameter.name == "order":
            turn = 2 * np.pi * ARM_M
            pitch = {"value": turn / value, "unit": "m", "ci95": [turn / ends[1], turn / ends[0]]}
            result["pitch_m"] = pitch
        else:
            unit, factor = _AXIS.get(parameter.unit, (parameter.unit, 1.0))
            scaled = [end * factor for end in ends]
            name = _renamed(parameter.name)
            result[name] = {"value": value * factor, "unit": unit, "ci95": scaled}
    return result


def _renamed(name: str) -> str:
    for rotor, axis in _SUFFIX.items():
        if name.endswith(rotor):
            return name.removesuffix(rotor) + axis
    return name
