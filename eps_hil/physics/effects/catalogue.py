"""All effects of this folder, found by their files; and what a model file may say of them."""

import importlib
import math
import pkgutil
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from functools import cache
from typing import Any

from eps_hil.physics import effects
from eps_hil.physics.effects.effect import RIGID, Effect, Joint, Slot
from eps_hil.physics.model import Model

_NO_EFFECT = ("effect", "catalogue", "added")
_OF_MODEL = ("belt_ratio", "pole_pairs")
_MOST_KNOTS = 32


@cache
def catalogue() -> Mapping[str, Effect]:
    """Every effect by its id, in the order of their files' names."""
    names = sorted(
        file.name for file in pkgutil.iter_modules(effects.__path__) if file.name not in _NO_EFFECT
    )
    found = [importlib.import_module(f"{effects.__name__}.{name}").EFFECT for name in names]
    return {effect.id: effect for effect in found}


def values_of(
    entry: Mapping[str, Any], model: Model, *, rig: bool = False
) -> tuple[Effect, dict[str, Any]]:
    """The effect and its checked numbers for one entry of a model file's ``effects``.

    ``rig``: also effects that only a simulated rig can have (``Effect.on_bus``). ``ValueError``
    says what is wrong: an unknown effect or parameter, a value that is missing, no number, or
    outside the bounds in which it makes physical sense.
    """
    name = entry.get("effect")
    known = catalogue()
    if not isinstance(name, str) or name not in known:
        near = get_close_matches(str(name), known, n=1)
        hint = f"; did you mean '{near[0]}'?" if near else f"; known: {', '.join(known)}"
        raise ValueError(f"'{name}' is no effect{hint}")
    effect = known[name]
    if not effect.simulated and not (rig and effect.on_bus):
        raise ValueError(
            f"'{name}' acts on what a rig reports: only the model of 'eps-hil rig' may hold it"
            if effect.on_bus
            else f"'{name}' can be named in a diagnosis, but not be simulated"
        )
    if effect.read is not None:
        return effect, effect.read(entry)
    names = [parameter.name for parameter in effect.parameters]
    for key in entry:
        if key not in (*names, "effect"):
            raise ValueError(f"{name} has no parameter '{key}'; it has {', '.join(names)}")
    return effect, {p.name: _value(name, p, entry, model) for p in effect.parameters}


def can_be(entry: Mapping[str, Any], model: Model) -> bool:
    """Whether a rig can have the entry: a channel in another unit fits what no drive is."""
    effect = catalogue()[str(entry["effect"])]
    if not effect.simulated and not effect.on_bus:
        return True
    try:
        values_of(entry, model, rig=True)
    except ValueError:
        return False
    return True


def _value(name: str, parameter: Any, entry: Mapping[str, Any], model: Model) -> Any:
    value = entry.get(parameter.name, parameter.default)
    if parameter.name in _OF_MODEL and parameter.name not in entry:
        return float(getattr(model, parameter.name))
    if value is None:
        raise ValueError(f"{name} needs {parameter.name} ({parameter.unit})")
    if parameter.name == "curve":
        return _curve(name, value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name}.{parameter.name} is {value!r}, a number was expected")
    if parameter.is_phase and math.isfinite(value) and abs(value) > math.pi:
        value = math.remainder(value, 2.0 * math.pi)
    low, high = parameter.domain
    if not (math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{name}.{parameter.name} is {value}, expected {parameter.allowed}")
    return float(value)


def _curve(name: str, value: Any) -> tuple[tuple[float, float], ...]:
    try:
        knots = tuple((float(x), float(torque)) for x, torque in value)
    except (TypeError, ValueError):
        raise ValueError(f"{name}.curve is no list of [position_m, torque_nm] pairs") from None
    positions = [x for x, _ in knots]
    if not 2 <= len(knots) <= _MOST_KNOTS or positions != sorted(set(positions)):
        raise ValueError(f"{name}.curve needs 2 to {_MOST_KNOTS} knots with rising positions")
    if not all(math.isfinite(number) for knot in knots for number in knot):
        raise ValueError(f"{name}.curve holds a number that is not finite")
    return knots


_worked_in: deque[tuple[Model, Model]] = deque(maxlen=8)
"""The last models, which do not change, and what became of them: a fit asks many times for one."""


def with_model_effects(model: Model) -> Model:
    """The model with those effects worked in, and taken off its list, that change its numbers.

    What is left in ``effects`` acts at run time (see ``added.py``); doing it twice changes nothing.
    """
    if not model.effects:
        return model
    for known, found in tuple(_worked_in):  # other threads may add to it at any time
        if known is model or found is model:
            return found
    found = _with_model_effects(model)
    _worked_in.append((model, found))
    return found


def _with_model_effects(model: Model) -> Model:
    left: list[Mapping[str, Any]] = []
    worked_in = False
    for entry in model.effects:
        effect, values = values_of(entry, model)
        if effect.slot is Slot.MODEL and effect.change is not None:
            worked_in = True
            model = effect.change(model, values)
            rest = effect.left(values) if effect.left is not None else None
            left += [] if rest is None else [{"effect": effect.id, **rest}]
        else:
            left.append(entry)
    return replace(model, effects=tuple(left)) if worked_in else model


def joint_of(model: Model, bare: Joint = RIGID) -> Joint | None:
    """The joint between rotor and rack with the model's effects in it; None if it is rigid.

    ``bare``: what the effects change, a joint that is as stiff as it should be.
    """
    joint: Joint | None = None
    for entry in model.effects:
        effect, values = values_of(entry, model)
        if effect.joint is not None:
            joint = effect.joint(joint or bare, values)
    return joint
