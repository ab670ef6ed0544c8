"""The effects of one model as compiled code runs them: one function a slot, fused at import.

Each slot's function walks through all effects of that slot; one that is not there costs a branch,
not a recompile, so the machine code is the same for every model. An effect may be there several
times (two cogging orders; a Stribeck term beside one that the model has): the terms follow on one
another, each with its own memory.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.physics.effects.catalogue import catalogue, values_of
from eps_hil.physics.effects.effect import (
    STATES,
    WIDTH,
    Effect,
    Floats,
    Instant,
    Kernel,
    Ratios,
    Slot,
)
from eps_hil.physics.model import Model

_F = TypeVar("_F", bound=Callable[..., Any])


def _rows() -> list[Effect]:
    """The effects that act at run time, in table order; one that may act in several slots once
    for each of them."""
    found = []
    for effect in catalogue().values():
        if (effect.kernel or effect.elsewhere) and effect.simulated:
            found.append(effect)
        found += [
            replace(effect, id=_row_id(effect, slot), slot=slot, kernel=kernel)
            for slot, kernel in effect.slots.items()
        ]
    return found


def _row_id(effect: Effect, slot: Slot) -> str:
    return f"{effect.id}_{slot.value}"


_KERNELS = _rows()
_ROW = {effect.id: row for row, effect in enumerate(_KERNELS)}
Acting = tuple[Effect, Kernel]
"""An effect with the kernel that it has in one slot."""
MOST_TERMS = 4
"""How many terms of one effect a model may have."""


class Added(NamedTuple):
    """What is added to the model, a row an effect.

    ``terms`` (n,) counts its terms, ``parameters`` (n, MOST_TERMS, WIDTH) and ``state``
    (n, MOST_TERMS, STATES) are theirs;
    ``spare``, as the latter, is room for another state of them.
    """

    terms: npt.NDArray[np.int64]
    parameters: Floats
    state: Floats
    spare: Floats


def added(model: Model, only: Callable[[Effect, Slot], bool] | None = None) -> Added:
    """The kernels' table for a model; ``ValueError`` for an entry that is wrong.

    ``only`` picks entries by their effect and the slot that they act in.
    """
    table = Added(
        np.zeros(len(_KERNELS), np.int64),
        np.zeros((len(_KERNELS), MOST_TERMS, WIDTH)),
        np.zeros((len(_KERNELS), MOST_TERMS, STATES)),
        np.zeros((len(_KERNELS), MOST_TERMS, STATES)),
    )
    for _, _, row, term, numbers in terms(model, only):
        table.terms[row] = term + 1
        table.parameters[row, term, : len(numbers)] = numbers
    return table


def terms(
    model: Model, only: Callable[[Effect, Slot], bool] | None = None
) -> list[tuple[Effect, dict[str, Any], int, int, list[float]]]:
    """Effect, checked values, row, place in the row, and the kernel's numbers of each entry that
    acts at run time, in the model's order; as :func:`added`."""
    found = []
    count = [0] * len(_KERNELS)
    for entry in model.effects:
        effect, values = values_of(entry, model)
        slot = effect.slot if effect.slot_of is None else effect.slot_of(values)
        name = effect.id if effect.slot_of is None else _row_id(effect, slot)
        if name not in _ROW or (only is not None and not only(effect, slot)):
            continue
        row = _ROW[name]
        term = count[row]
        if term == MOST_TERMS:
            raise ValueError(f"'{effect.id}' stands more than {MOST_TERMS} times among the effects")
        count[row] += 1
        numbers = _numbers(values) if effect.numbers is None else effect.numbers(values)
        found.append((effect, values, row, term, numbers))
    return found


class InUse(NamedTuple):
    """Which slots have an effect that is on, so that the others need not be called at all.

    ``memory``: an effect remembers something (rest times, …) that has to be moved on. ``ranged``:
    an effect is known in a range only.
    """

    level: bool
    torque: bool
    motor: bool
    sensor: bool
    position: bool
    load: bool
    memory: bool
    ranged: bool


def in_use(table: Added) -> InUse:
    """The slots of a model's table that do anything."""

    return InUse(*(bool(table.terms[rows].any()) for rows in _ROWS_OF_SLOTS))


def _numbers(values: dict[str, Any]) -> list[float]:
    """Parameters in the kernel's order; a curve as its length and then its knots."""
    if "curve" in values:
        knots = values["curve"]
        return [float(len(knots)), *(number for knot in knots for number in knot)]
    return [float(value) for value in values.values()]


def _compiled(function: _F, name: str) -> _F:
    """``function``, a closure, compiled under a name that no other closure has.

    numba names machine code by qualified name and a number that counts compilations in one
    process. Closures of one name out of a disk cache that several processes filled would be taken
    for one another, and one effect would act as another.
    """
    function.__qualname__ = function.__name__ = name
    return kernel(function)


def _fused(slot: str, effects: list[Acting]) -> Callable[[Added, Instant, float], float]:
    """One compiled function that passes a value through the kernels of ``effects`` in order."""

    def build(k: int) -> Callable[[Added, Instant, float], float]:
        if k < 0:

            def unchanged(_a: Added, _u: Instant, value: float) -> float:
                return value

            return _compiled(unchanged, f"{slot}_unchanged")
        effect, kernel = effects[k]
        before, row = build(k - 1), _ROW[effect.id]

        def through(a: Added, u: Instant, value: float) -> float:
            value = before(a, u, value)
            for term in range(a.terms[row]):
                value = kernel(a.parameters[row, term], a.state[row, term], u, value)
            return value

        return _compiled(through, f"{slot}_through_{effect.id}")

    return build(len(effects) - 1)


def _told() -> list[Acting]:
    """Errors of the torsion bar's sensor, from the true torque to the reported one."""
    backward = sorted(_KERNELS, key=lambda one: one.stage, reverse=True)
    return [(effect, effect.told) for effect in backward if effect.told is not None]


def _fused_advance(name: str, effects: list[Effect]) -> Callable[[Added, Instant, float], None]:
    def build(k: int) -> Callable[[Added, Instant, float], None]:
        if k < 0:

            def nothing(_a: Added, _u: Instant, _dt: float) -> None:
                return None

            return _compiled(nothing, f"{name}_nothing")
        before, move, row = build(k - 1), effects[k].advance, _ROW[effects[k].id]
        assert move is not None

        def through(a: Added, u: Instant, dt: float) -> None:
            before(a, u, dt)
            for term in range(a.terms[row]):
                move(a.parameters[row, term], a.state[row, term], u, dt)

        return _compiled(through, f"{name}_through_{effects[k].id}")

    return build(len(effects) - 1)


def _fused_outside(effects: list[Effect]) -> Callable[[Added, Instant], bool]:
    def build(k: int) -> Callable[[Added, Instant], bool]:
        if k < 0:

            def inside(_a: Added, _u: Instant) -> bool:
                return False

            return _compiled(inside, "outside_none")
        before, outside, row = build(k - 1), effects[k].outside, _ROW[effects[k].id]
        assert outside is not None

        def through(a: Added, u: Instant) -> bool:
            if before(a, u):
                return True
            for term in range(a.terms[row]):  # noqa: SIM110 (any() is not compiled)
                if outside(a.parameters[row, term], u):
                    return True
            return False

        return _compiled(through, f"outside_{effects[k].id}")

    return build(len(effects) - 1)


@kernel(inline="always")
def instant(motion: Any, k: int, ratios: Ratios) -> Instant:
    """Sample ``k`` of a measured motion (``balance.Motion``) as a kernel is given it."""
    angle = motion.angle_rad[k]
    return Instant(
        motion.time_s[k],
        motion.speed_rad_s[k],
        angle,
        motion.position_m[k],
        motion.rack_force_n[k],
        angle * ratios.sensor_to_rotor,
        motion.motor_torque_nm[k],
        motion.torque_sensor_nm[k],
        ratios.rad_per_m,
    )


@kernel(inline="always")
def crept(motion: Any, k: int, u: Instant, step_s: float) -> Instant:
    """The same with the speed of a resting rotor's creep: what remembers rest wants to know."""
    speed = u.speed_rad_s if u.speed_rad_s != 0.0 else motion.travel_rad[k] / step_s
    return Instant(u[0], speed, u[2], u[3], u[4], u[5], u[6], u[7], u[8])


def _fused_along(slot: str, effects: list[Acting]) -> Callable[[Added, Any, Ratios, Floats], None]:
    """As :func:`_fused`, for a whole motion: effect by effect, each through all samples.

    The same operations in the same order for every sample, and several times as fast: what a
    kernel is given is looked up once an effect, not once a sample.
    """

    def build(k: int) -> Callable[[Added, Any, Ratios, Floats], None]:
        if k < 0:

            def nothing(_a: Added, _m: Any, _r: Ratios, _values: Floats) -> None:
                return None

            return _compiled(nothing, f"{slot}_along_nothing")
        effect, kernel = effects[k]
        before, row, move = build(k - 1), _ROW[effect.id], effect.advance or _stay

        def along(a: Added, m: Any, ratios: Ratios, values: Floats) -> None:
            before(a, m, ratios, values)
            step = m.time_s[1] - m.time_s[0] if len(values) > 1 else 1e-3
            for term in range(a.terms[row]):
                p, s = a.parameters[row, term], a.state[row, term]
                for i in range(len(values)):
                    u = instant(m, i, ratios)
                    values[i] = kernel(p, s, u, values[i])
                    move(p, s, crept(m, i, u, step), step)

        return _compiled(along, f"{slot}_along_{effect.id}")

    return build(len(effects) - 1)


def _fused_levels(effects: list[Acting]) -> Callable[[Added, Any, Ratios, Floats, Floats], None]:
    """The same for the friction's level, twice where the rotor rests without a direction.

    There the bristle decides which of the two levels holds, and it is not known yet.
    """

    def build(k: int) -> Callable[[Added, Any, Ratios, Floats, Floats], None]:
        if k < 0:

            def nothing(_a: Added, _m: Any, _r: Ratios, _up: Floats, _down: Floats) -> None:
                return None

            return _compiled(nothing, "levels_along_nothing")
        effect, kernel = effects[k]
        before, row, move = build(k - 1), _ROW[effect.id], effect.advance or _stay

        def along(a: Added, m: Any, ratios: Ratios, levels: Floats, otherwise: Floats) -> None:
            before(a, m, ratios, levels, otherwise)
            step = m.time_s[1] - m.time_s[0] if len(levels) > 1 else 1e-3
            for term in range(a.terms[row]):
                p, s = a.parameters[row, term], a.state[row, term]
                for i in range(len(levels)):
                    u = instant(m, i, ratios)
                    levels[i] = kernel(p, s, u, levels[i])
                    if u.speed_rad_s == 0.0 and m.travel_rad[i] == 0.0:
                        otherwise[i] = kernel(p, s, u, otherwise[i])
                    move(p, s, crept(m, i, u, step), step)

        return _compiled(along, f"levels_along_{effect.id}")

    return build(len(effects) - 1)


@kernel(inline="always")
def _stay(_p: Floats, _s: Floats, _u: Instant, _dt: float) -> None:
    return None


def _of(slot: Slot) -> list[Acting]:
    """What acts in a slot, in its order."""
    found = []
    for effect in sorted(_KERNELS, key=lambda one: one.stage):
        kernel = effect.kernel if effect.slot is slot else effect.elsewhere.get(slot)
        found += [] if kernel is None else [(effect, kernel)]
    return found


def _remembering(effects: list[Effect]) -> list[Effect]:
    return [effect for effect in effects if effect.advance is not None]


def _ranged(effects: list[Effect]) -> list[Effect]:
    return [effect for effect in effects if effect.outside is not None]


_LEVELS = _of(Slot.LEVEL) + _of(Slot.LEVEL_FACTOR)
_SLOTS = (_LEVELS, *map(_of, (Slot.TORQUE, Slot.MOTOR, Slot.SENSOR, Slot.POSITION, Slot.LOAD)))
_ROWS_OF_SLOTS = [
    np.array([_ROW[effect.id] for effect in effects], np.int64)
    for effects in (
        *([one for one, _ in _of_slot] for _of_slot in _SLOTS),
        _remembering(_KERNELS),
        _ranged(_KERNELS),
    )
]
"""In the order of :class:`InUse`."""
LEVEL_ROWS = np.concatenate(
    [_ROWS_OF_SLOTS[InUse._fields.index(one)] for one in ("level", "position")]
)
"""Rows of the table that act on the friction's level, or on the place that it may depend on."""
WALK: dict[str, list[tuple[int, Callable[..., Any]]]] = {
    **{
        name: [(_ROW[effect.id], kernel) for effect, kernel in acting]
        for name, acting in zip(InUse._fields, _SLOTS, strict=False)
    },
    "memory": [(_ROW[one.id], one.advance) for one in _remembering(_KERNELS) if one.advance],
}
"""Row and kernel of what acts in each slot, in its order, for whoever walks it elsewhere."""

level_nm = _fused("level", _LEVELS)
"""T_fs (Nm) with the added terms: ``level_nm(added, instant, level of eq. 3)``."""
torque_nm = _fused("torque", _of(Slot.TORQUE))
"""Torque that opposes the drive beside friction and load: ``torque_nm(added, instant, 0.0)``."""
motor_nm = _fused("motor", _of(Slot.MOTOR))
"""Shaft torque of the motor from the reported one."""
sensor_nm = _fused("sensor", _of(Slot.SENSOR))
"""True torsion-bar torque from the reported one, at the column."""
told_nm = _fused("told", _told())
"""What the sensor reports of a true torsion-bar torque; once a sample, in order."""
position_m = _fused("position", _of(Slot.POSITION))
"""The rack's position from φ/i_APA (m): ``position_m(added, instant, φ/i_APA)``."""
load_nm = _fused("load", _of(Slot.LOAD))
"""What F/i_APA (Nm) is at this place of the rack: ``load_nm(added, instant, F/i_APA)``."""
advance = _fused_advance("advance", _remembering(_KERNELS))
"""Moves what effects remember (rest times, …) on by one step."""
out_of_range = _fused_outside(_ranged(_KERNELS))
"""Whether an effect is asked beyond the range that it is known in."""
load_along = _fused_along("load", _of(Slot.LOAD))
torque_along = _fused_along("torque", _of(Slot.TORQUE))
motor_along = _fused_along("motor", _of(Slot.MOTOR))
sensor_along = _fused_along("sensor", _of(Slot.SENSOR))
"""``(added, motion, ratios, values (n,))``: the slots' values of a whole motion, in place; what
the effects of the slot remember is moved on with it."""
levels_along = _fused_levels(_LEVELS)
"""``(added, motion, ratios, T_fs (n,), T_fs the other way (n,))``: the levels of a motion, in
place; the second only where neither speed nor travel say a direction."""
