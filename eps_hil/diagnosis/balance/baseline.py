"""The numbers that every model file holds, free to move while an effect is looked for.

An effect counts only for what no refit of these could do (DIAGNOSIS 3). Each knob is measured from
the model file's value in units in which one is a usual error of that number; a prior of that width
keeps apart what the recordings cannot tell apart, and costs an error of the usual size next to
nothing beside a gain that is seen.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

from eps_hil.diagnosis.data.size import ORDINARY, Size
from eps_hil.physics.empirical_entry import NUMBERS, SIGNS
from eps_hil.physics.model import Friction, Model

Width = Callable[[Model, Size], float]

OFFSET, HOLD, SPRING = "motor_torque_offset", "motor_torque_delay", "unmodelled_spring"
STIFFNESS, DAMPING = "sigma0_nm_per_rad", "sigma1_nm_s_per_rad"
GRAVITY = ("gravity_sin", "gravity_cos")
"""A weight on a turning joint: torques that follow the sine and the cosine of its angle."""
_LEARNT, _SPRING_NM_PER_RAD = "empirical", 1e-3
OFFSET_NM = 0.02
HOLD_S = 0.4e-3
"""A torque held for a sample of 1 ms is half of it late on the shaft, if it is held."""


@dataclass(frozen=True, slots=True)
class Knob:
    """One number: where ``turn`` puts the model for a value, and what a small step of it is."""

    name: str
    turn: Callable[[Model, float, Size], Model]
    step: float = 0.05


def _friction(name: str, width: Width) -> Knob:
    """A number that a model file holds only from zero up."""

    def turn(model: Model, value: float, size: Size) -> Model:
        moved = max(getattr(model.friction, name) + value * width(model, size), 0.0)
        return replace(model, friction=replace(model.friction, **{name: moved}))

    return Knob(name, turn)


def _difference(name: str, width: Width) -> Knob:
    """Both directions of a number turned against each other: what their mean cannot do."""
    pos, neg = (name.replace("difference", side) for side in ("pos", "neg"))

    def turn(model: Model, value: float, size: Size) -> Model:
        change = value * width(model, size)
        moved = {
            pos: max(getattr(model.friction, pos) + change, 0.0),
            neg: max(getattr(model.friction, neg) - change, 0.0),
        }
        return replace(model, friction=replace(model.friction, **moved))

    return Knob(name, turn)


def _times(value: float, log_width: float) -> float:
    """What multiplies a positive number; a step of a fit may be as wild as it likes."""
    return math.exp(max(-40.0, min(40.0, value)) * log_width)


def _factor(name: str, log_width: float) -> Knob:
    def turn(model: Model, value: float, _size: Size) -> Model:
        moved = getattr(model.friction, name) * _times(value, log_width)
        return replace(model, friction=replace(model.friction, **{name: moved}))

    return Knob(name, turn)


def _inertia(model: Model, value: float, _size: Size) -> Model:
    return replace(model, inertia_kg_m2=model.inertia_kg_m2 * _times(value, 0.2))


def _raised(
    effect: str, parameter: str, width: Callable[[Size], float]
) -> Callable[[Model, float, Size], Model]:
    """A number that the model has only as an effect: a term more of it."""

    def turn(model: Model, value: float, size: Size) -> Model:
        entry = {"effect": effect, parameter: value * width(size)}
        return replace(model, effects=(*model.effects, entry))

    return turn


def weight(torque_nm: float, phase_rad: float) -> dict[str, object]:
    """A model file's entry of a torque that follows the sine of the angle: a weight's."""
    return {
        "effect": _LEARNT,
        "form": "law",
        "where": "rotor",
        "how": "sum",
        "inputs": ["motor_angle_rad"],
        "memory": ["none"],
        "shapes": ["sine"],
        "size": torque_nm,
        "order_1": 1.0,
        "phase_1": phase_rad,
    }


def _hung(phase_rad: float) -> Callable[[Model, float, Size], Model]:
    def turn(model: Model, value: float, size: Size) -> Model:
        entry = weight(value * OFFSET_NM * size.torque, phase_rad)
        return replace(model, effects=(*model.effects, entry))

    return turn


def _hold(model: Model, value: float, _size: Size = ORDINARY) -> Model:
    late = model.delays_s.motor_torque - value * HOLD_S
    return replace(model, delays_s=replace(model.delays_s, motor_torque=late))


def _mean(kind: str, share: float, least: Callable[[Size], float]) -> Width:
    """A share of the mean of both directions, and at least so much that zero can be mended."""

    def width(model: Model, size: Size) -> float:
        both = (getattr(model.friction, kind.format(side)) for side in ("pos", "neg"))
        return share * sum(both) / 2 + least(size)

    return width


_LEVEL = _mean("offset_{}_nm", 0.3, lambda size: 0.005 * size.torque)
_DRAG = _mean("viscous_{}_nm_s_per_rad", 0.5, lambda size: 2e-4 * size.torque / size.angle)
_LOAD = _mean("load_{}_nm_per_n", 0.4, lambda size: 5e-6 * size.place / size.angle)

KNOBS: Sequence[Knob] = (
    _friction("offset_pos_nm", _LEVEL),
    _friction("offset_neg_nm", _LEVEL),
    _friction("viscous_pos_nm_s_per_rad", _DRAG),
    _friction("viscous_neg_nm_s_per_rad", _DRAG),
    _friction("load_pos_nm_per_n", _LOAD),
    _friction("load_neg_nm_per_n", _LOAD),
    _factor(STIFFNESS, 0.4),
    _factor(DAMPING, 0.5),
    Knob("inertia", _inertia),
    Knob(OFFSET, _raised(OFFSET, "offset_nm", lambda size: OFFSET_NM * size.torque)),
    Knob(HOLD, _hold, 0.25),
    Knob(
        SPRING,
        _raised(
            SPRING,
            "stiffness_nm_per_rad",
            lambda size: _SPRING_NM_PER_RAD * size.torque / size.angle,
        ),
    ),
    Knob(GRAVITY[0], _hung(0.0)),
    Knob(GRAVITY[1], _hung(0.5 * math.pi)),
    _difference("viscous_difference_nm_s_per_rad", _DRAG),
    _difference("load_difference_nm_per_n", _LOAD),
)
"""J, k0±, kω±, kr±, σ0, σ1, a constant torque, how the motor's torque is held. Then a spring and a
weight, which only stand for a load that nobody measured, and differences, which only go with a
name."""

SIDES: Mapping[str, tuple[str, ...]] = {
    "viscous_friction": ("viscous_difference_nm_s_per_rad",),
    "load_dependent_friction": ("load_difference_nm_per_n",),
    HOLD: (HOLD,),
    "": (DAMPING,),
}
"""Numbers that no name of the contract describes alone: they go with a name, or unnamed.

Never both directions beside their name: a drag in the bristle less the same drag outside it is
nothing but a lag of the bristle, which fits the form of any other friction a little better.
"""

_BESIDE = (SPRING, *GRAVITY, *SIDES["viscous_friction"], *SIDES["load_dependent_friction"])
ALL: Mapping[str, float] = {knob.name: 0.0 for knob in KNOBS if knob.name not in _BESIDE}
TIMING: Mapping[str, float] = {HOLD: 0.0}
"""Fitted even where nothing else is: how a torque is sampled is no finding, and no other effect."""

_BY_NAME = {knob.name: knob for knob in KNOBS}

_LAW = "law"
_LAW_WIDTH = 0.3
"""What an error of usual size is of a learnt law's number: a share, or of a phase in rad."""
_ORDER_WIDTH = 1e-3

_TERMS = (OFFSET, SPRING, *GRAVITY)


def levels_of(model: Model, size: Size = ORDINARY) -> dict[str, float]:
    """Knobs of both directions' friction levels, each with how far it is to twice its own level."""
    return {
        name: getattr(model.friction, name) / _LEVEL(model, size)
        for name in ("offset_pos_nm", "offset_neg_nm")
    }


def is_free(own: Mapping[str, float]) -> bool:
    """Whether all of the model's own numbers are free, and go with no name."""
    return "inertia" in own


def law_knobs(model: Model, first: int) -> dict[str, float]:
    """Knobs of the numbers of learnt laws among the model's effects, from place ``first`` on.

    Of a curve or map the size alone, and no centre of a sign, which is -1 or 1. Like ``tied``
    numbers they are free in every fit: a name is worth what it gains beside a law that is fitted
    again.
    """
    names = []
    for k, entry in enumerate(model.effects):
        if k >= first and entry["effect"] == _LEARNT:
            signs = {f"centre_{i}" for i, one in enumerate(entry["inputs"], 1) if one in SIGNS}
            keys = [key for key in entry if key.rpartition("_")[0] in NUMBERS and key not in signs]
            names += [f"{_LAW}.{k}.{key}" for key in ("size", *keys)]
    return dict.fromkeys(names, 0.0)


def of_law(name: str) -> bool:
    """Whether a knob is a learnt law's number."""
    return name.startswith(f"{_LAW}.")


def knob_of(name: str) -> Knob:
    """The knob with that name, one of a learnt law's numbers included."""
    if not of_law(name):
        return _BY_NAME[name]
    return Knob(name, lambda model, value, _size: _law_moved(model, name, value))


def _law_moved(model: Model, name: str, value: float) -> Model:
    _, place, key = name.split(".")
    entry = dict(model.effects[int(place)])
    number, kind = float(entry.get(key, 1.0)), key.rpartition("_")[0]
    if kind in ("width", "memory"):
        number *= _times(value, _LAW_WIDTH)
    elif kind == "phase":
        number += _LAW_WIDTH * value
    elif kind == "centre":
        i = key.rpartition("_")[2]
        number += _LAW_WIDTH * value * float(entry.get(f"width_{i}", abs(number) or 1.0))
    else:
        number *= 1.0 + (_ORDER_WIDTH if kind == "order" else _LAW_WIDTH) * value
    entry[key] = number
    effects = list(model.effects)
    effects[int(place)] = entry
    return replace(model, effects=tuple(effects))


def turned(model: Model, values: Mapping[str, float], size: Size = ORDINARY) -> Model:
    """The model with its own numbers moved by ``values`` (knob name -> multiples of its width)."""
    if not values:
        return model
    nominal = model
    for name, value in values.items():
        if name == HOLD:
            model = _hold(model, value)
        elif of_law(name):
            model = _law_moved(model, name, value)
        elif name not in _TERMS and value != 0.0:
            model = _merged(model, nominal, _BY_NAME[name].turn(nominal, value, size))
    for name in _TERMS:
        if values.get(name, 0.0) != 0.0:
            model = _BY_NAME[name].turn(model, values[name], size)
    return model


def _merged(model: Model, nominal: Model, moved: Model) -> Model:
    """Each knob is measured from the nominal model, so they do not scale one another."""
    friction = {}
    for name in (one.name for one in fields(Friction)):
        now, before, after = (getattr(each.friction, name) for each in (model, nominal, moved))
        if after != before:
            friction[name] = max(now + (after - before), 0.0)
    return replace(
        model,
        inertia_kg_m2=model.inertia_kg_m2 + (moved.inertia_kg_m2 - nominal.inertia_kg_m2),
        friction=replace(model.friction, **friction),
    )
