"""A change as numbers of the rig: what they were in the first state, what they are in the second.

An effect is written as what it adds to a model. Where it moves a number that the model has as well
(a friction level, a drag, a delay, a torque constant), what it adds in one state or in the other
says nothing of up or down: a level of 0.8 times the file's that rises to 0.9 is *higher*, although
less of the effect is left. Such a change is told by the whole number.
"""

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from eps_hil.identification.state import FRICTION_UNITS
from eps_hil.physics.effects.catalogue import catalogue, with_model_effects
from eps_hil.physics.effects.effect import Slot
from eps_hil.physics.model import Model
from eps_hil.unit_words import spaced

Entry = Mapping[str, Any]

_ALIKE = 0.02
"""Of a ratio: numbers that move together by it have one in common."""
_DRAG = "viscous_friction"
"""The model file has a drag for each direction, the effect adds one to both."""
_AS_STRONG = 0.15
"""Of an amplitude: a ripple whose own differs by less has only moved."""


@dataclass(frozen=True, slots=True)
class Moved:
    """One number that differs between two states."""

    name: str
    first: float
    second: float
    unit: str

    def content(self) -> dict[str, Any]:
        """For the JSON."""
        return {"name": self.name, "before": self.first, "after": self.second, "unit": self.unit}


def moved(name: str, first: Model, second: Model, more: Sequence[Entry]) -> list[Moved]:
    """Numbers of the rig that a change of effect ``name`` moves, as both states' models have them.

    Empty where it moves none that a model has without it. ``more``: what is added to ``first``.
    """
    effect = catalogue().get(name)
    if effect is None or not more:
        return []
    there, here = _flat(first), _flat(second)
    if (effect.slot is Slot.MODEL and effect.change is not None) or name == _DRAG:
        touched = _flat(replace(first, effects=(*first.effects, *map(dict, more))))
        return [
            Moved(key, there[key], here[key], _unit(key))
            for key in there
            if touched[key] != there[key]
        ]
    probe = effect.probe
    if probe is None or probe.neutral != 1.0:
        return []
    unit = next(one.unit for one in effect.parameters if one.name == probe.amplitude)
    was, now = (  # one gain after the other
        math.prod(float(e[probe.amplitude]) for e in one.effects if e["effect"] == name)
        for one in (first, second)
    )
    return [Moved(probe.amplitude, was, now, unit)]


def anew(name: str, first: Sequence[Entry], second: Sequence[Entry]) -> list[Moved]:
    """Numbers of an effect that each state has once, where they differ."""
    effect = catalogue().get(name)
    if effect is None or len(first) != 1 or len(second) != 1:
        return []
    return [
        Moved(one.name, float(first[0][one.name]), float(second[0][one.name]), one.unit)
        for one in effect.parameters
        if all(isinstance(entry.get(one.name), int | float) for entry in (first[0], second[0]))
        and first[0][one.name] != second[0][one.name]
    ]


def shifted(name: str, first: Sequence[Entry], second: Sequence[Entry]) -> list[Moved]:
    """Amplitude and phase of a ripple that is as strong as before and begins elsewhere; else empty.

    A new zero of the angle does that, or a part put back another way round.
    """
    effect = catalogue().get(name)
    probe = None if effect is None else effect.probe
    if effect is None or probe is None or probe.phase is None or not second:
        return []
    units = {one.name: one.unit for one in effect.parameters}
    shape = units.keys() - {probe.amplitude, probe.phase}

    def alike(one: Entry) -> bool:  # of the order that is looked at, if there are others
        pairs = [(float(one.get(key, 0.0)), float(second[-1].get(key, 0.0))) for key in shape]
        return all(abs(a - b) <= _ALIKE * max(abs(a), abs(b)) for a, b in pairs)

    first, second = ([one for one in entries if alike(one)] for entries in (first, second))
    if not first:
        return []
    was, now = (
        sum(cmath.rect(float(one[probe.amplitude]), float(one[probe.phase])) for one in entries)
        for entries in (first, second)
    )
    if abs(abs(now) - abs(was)) > _AS_STRONG * abs(was):
        return []
    return [
        Moved(probe.amplitude, abs(was), abs(now), units[probe.amplitude]),
        Moved(probe.phase, cmath.phase(was), cmath.phase(now), units[probe.phase]),
    ]


def shift_in_words(name: str, numbers: Sequence[Mapping[str, Any]], order: float | None) -> str:
    """What a ripple that is ``shifted`` did, by a finding's ``change.numbers``.

    ``order``: its periods per turn of the rotor, where it has such.
    """
    size, phase = numbers
    by = math.remainder(phase["after"] - phase["before"], math.tau)
    place = "" if not order else f", which is {math.degrees(abs(by) / order):.3g}° of the rotor"
    return (
        f"{catalogue()[name].name} as strong as in the first state "
        f"({size['after']:.3g}{spaced(size['unit'])}) begins {'earlier' if by > 0.0 else 'later'}: "
        f"its phase has moved by {abs(by):.3g} rad{place}. Has the angle another zero?"
    )


def ratio(numbers: Sequence[Moved]) -> float | None:
    """The factor that all of them share, second state by first; None where they have none."""
    if not numbers or any(one.first <= 0.0 or one.second < 0.0 for one in numbers):
        return None
    every = [one.second / one.first for one in numbers]
    return every[0] if max(every) - min(every) <= _ALIKE * max(every) else None


def in_words(numbers: Sequence[Mapping[str, Any]]) -> str:
    """``offset_pos_nm 0.0512 → 0.0553 Nm`` of a finding's ``change.numbers``."""
    return ", ".join(
        f"{one['name']} {one['before']:.4g} → {one['after']:.4g}{spaced(one['unit'])}"
        for one in numbers
    )


def _flat(model: Model) -> dict[str, float]:
    """Every number of the model, its effects worked in, by the name that its file gives it."""
    drag = sum(
        float(one["coefficient_nm_s_per_rad"]) for one in model.effects if one["effect"] == _DRAG
    )
    told = asdict(replace(with_model_effects(model), effects=()))
    nested = {"friction": told.pop("friction"), "delays_s": told.pop("delays_s")}
    numbers = {**told, **nested["friction"]}
    for side in ("viscous_pos_nm_s_per_rad", "viscous_neg_nm_s_per_rad"):
        numbers[side] += drag
    numbers |= {f"delays_s.{name}": value for name, value in nested["delays_s"].items()}
    return {k: float(v) for k, v in numbers.items() if isinstance(v, int | float)}


def _unit(name: str) -> str:
    return "s" if name.startswith("delays_s.") else _UNITS.get(name, "1")


_UNITS = {
    **FRICTION_UNITS,
    "inertia_kg_m2": "kg m²",
    "rack_to_rotor_ratio_rad_per_m": "rad/m",
}
