"""A law, a curve, a map or a filter that a diagnosis found in recordings, with its range.

    g = size · S₁(u₁) · S₂(u₂)        law; Sᵢ one of SHAPES, u an input or what is remembered of it
    g = table(u₁[, u₂])               curve or map, straight between its knots

Where it acts says ``where``; ``how`` says whether g is added there or is a relative change. Outside
the range of inputs that was seen, g fades to nothing over a fifth of that range.
"""

import math
from collections.abc import Callable, Mapping

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import (
    Effect,
    Floats,
    Instant,
    Kind,
    Parameter,
    Slot,
)
from eps_hil.physics.empirical_entry import (
    FORMS,
    INPUTS,
    MEMORIES,
    NUMBERS,
    SHAPES,
    WHERE,
    numbers,
    read,
    slot_of,
)

FADE = 0.2
"""Share of the range over which the effect fades out beyond it."""
_HOW, _TABLE, _COUNT, _SIZE, _FIRST, _EACH = 0, 1, 2, 3, 4, 10
_CODE, _MEMORY, _REMEMBERED, _SHAPE, _CENTRE, _WIDTH, _ORDER, _PHASE, _LOW, _HIGH = range(10)
_TABLE_AT = _FIRST + 2 * _EACH
_STATE = 3
"""Numbers that one input may remember."""
_TURNING_RAD_S = 0.5
"""Speed at which a torque counts as driving or braking to seven tenths."""


@kernel
def _raw(code: float, u: Instant) -> float:  # noqa: PLR0911, PLR0912 (a table of inputs)
    """An input at this instant; 0 for one that only memory knows."""
    kind = int(code)
    if kind == 0:
        return u.speed_rad_s
    if kind == 1:
        return abs(u.speed_rad_s)
    if kind == 2:
        return u.angle_rad
    if kind == 3:
        return u.position_m
    if kind == 4:
        return u.motor_torque_nm
    if kind == 5:
        return abs(u.motor_torque_nm)
    if kind == 6:
        return u.torque_sensor_nm
    if kind == 7:
        return abs(u.torque_sensor_nm)
    if kind == 8:
        return u.rack_force_n
    if kind == 9:
        return abs(u.rack_force_n)
    if kind == 10:
        return u.time_s
    if kind == 15:
        return u.motor_torque_nm * u.speed_rad_s
    if kind == 16:
        return abs(u.motor_torque_nm * u.speed_rad_s)
    turning = u.speed_rad_s / math.sqrt(
        u.speed_rad_s * u.speed_rad_s + _TURNING_RAD_S * _TURNING_RAD_S
    )
    if kind == 12:
        return _sign(u.motor_torque_nm) * turning
    if kind == 13:  # the load drives where it pushes the way the rotor turns
        return -_sign(u.rack_force_n) * turning
    if kind == 14:
        return _sign(u.torque_sensor_nm) * turning
    return 0.0


@kernel
def _sign(value: float) -> float:
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)


@kernel
def _seen(p: Floats, s: Floats, u: Instant, i: int) -> float:
    """Input ``i``, or what is remembered of it."""
    at = _FIRST + i * _EACH
    memory = int(p[at + _MEMORY])
    if int(p[at + _CODE]) == 11 or memory not in (0, 4):
        return s[i * _STATE]
    raw = _raw(p[at + _CODE], u)
    if memory == 4:  # a stop: the part of the way that has not slipped
        if s[i * _STATE + 2] == 0.0:
            return 0.0
        return min(max((raw - s[i * _STATE]) / p[at + _REMEMBERED], -1.0), 1.0)
    return raw


@kernel
def _shaped(p: Floats, at: int, x: float, rate: float) -> float:  # noqa: PLR0911
    shape = int(p[at + _SHAPE])
    if shape == 1:
        return x
    if shape == 2:
        return x * x
    if shape == 3:
        return math.tanh(x / p[at + _WIDTH])
    if shape == 4:
        return max(x - p[at + _CENTRE], 0.0)
    if shape == 5:
        return max(p[at + _CENTRE] - x, 0.0)
    if shape == 6:
        off = (x - p[at + _CENTRE]) / p[at + _WIDTH]
        return math.exp(-min(off * off, 60.0))
    if shape == 7:
        # as resolved() in effect.py: an angle told at 1 kHz shows no ripple that is faster
        beyond = (abs(p[at + _ORDER] * rate) - 2513.3) / 628.3
        share = 1.0 - min(max(beyond, 0.0), 1.0)
        return share * math.sin(p[at + _ORDER] * x + p[at + _PHASE])
    if shape == 8:
        return math.exp(min(max(-(x - p[at + _CENTRE]) / p[at + _WIDTH], -60.0), 20.0))
    if shape == 9:
        off = min(max((x - p[at + _CENTRE]) / p[at + _WIDTH], -40.0), 40.0)
        return 1.0 / (1.0 + math.exp(-off))
    if shape == 10:
        off = x / p[at + _WIDTH]
        return 1.0 / (1.0 + off * off)
    return 1.0


@kernel
def _left(low: float, high: float, x: float) -> float:
    """Share of the effect at ``x``: 1 inside the range, falling to 0 beyond it."""
    if low >= high:
        return 1.0
    beyond = max(low - x, x - high)
    return 1.0 if beyond <= 0.0 else max(1.0 - beyond / (FADE * (high - low)), 0.0)


@kernel
def _place(p: Floats, first: int, n: int, x: float) -> tuple[int, float]:
    """Interval of ``n`` knots from ``p[first]`` on that ``x`` is in, and how far into it (0..1)."""
    if x <= p[first]:
        return 0, 0.0
    for k in range(1, n):
        if x <= p[first + k]:
            return k - 1, (x - p[first + k - 1]) / (p[first + k] - p[first + k - 1])
    return n - 2, 1.0


@kernel
def _from_table(p: Floats, x: float, y: float) -> float:
    n, m = int(p[_TABLE_AT]), int(p[_TABLE_AT + 1])
    knots = _TABLE_AT + 2
    values = knots + n + m
    i, a = _place(p, knots, n, x)
    if m == 0:
        return (1.0 - a) * p[values + i] + a * p[values + i + 1]
    j, b = _place(p, knots + n, m, y)
    at = values + i * m + j
    return (1.0 - a) * ((1.0 - b) * p[at] + b * p[at + 1]) + a * (
        (1.0 - b) * p[at + m] + b * p[at + m + 1]
    )


@kernel
def term(p: Floats, s: Floats, u: Instant) -> float:
    """g of the module's equations for packed numbers ``p`` (:func:`numbers`) and its memory."""
    left, x, y = 1.0, 0.0, 0.0
    product = 1.0
    table = p[_TABLE] != 0.0
    for i in range(int(p[_COUNT])):
        at = _FIRST + i * _EACH
        left *= _left(p[at + _LOW], p[at + _HIGH], _raw(p[at + _CODE], u))
        if left == 0.0:
            return 0.0
        seen = _seen(p, s, u, i)
        if table:
            if i == 0:
                x = seen
            else:
                y = seen
        else:
            rate = u.speed_rad_s if int(p[at + _CODE]) == 2 else 0.0
            product *= _shaped(p, at, seen, rate)
    if table:
        return left * p[_SIZE] * _from_table(p, x, y)
    return left * p[_SIZE] * product


@kernel
def _kernel(p: Floats, s: Floats, u: Instant, value: float) -> float:
    change = term(p, s, u)
    return value * (1.0 + change) if p[_HOW] == 1.0 else value + change


@kernel
def remember(p: Floats, s: Floats, u: Instant, dt: float) -> None:
    """Moves what the inputs remember on by ``dt`` (s)."""
    for i in range(int(p[_COUNT])):
        at, own = _FIRST + i * _EACH, i * _STATE
        memory = int(p[at + _MEMORY])
        if int(p[at + _CODE]) == 11:
            direction = _sign(u.speed_rad_s)
            s[own] += dt
            if direction != 0.0 and direction != s[own + 1]:
                s[own], s[own + 1] = 0.0, direction
            continue
        if memory == 0:
            continue
        raw, size = _raw(p[at + _CODE], u), p[at + _REMEMBERED]
        if memory == 2:
            s[own] -= (raw * raw - s[own]) * math.expm1(-dt / size)
            continue
        if s[own + 2] == 0.0:  # before the first sample nothing has happened
            s[own] = 0.0 if memory == 5 else raw
            s[own + 1], s[own + 2] = raw, 1.0
        elif memory == 1:
            s[own] -= (raw - s[own]) * math.expm1(-dt / size)
        elif memory == 5:  # Bouc and Wen's with exponent 1: dz = (dx − |dx| z)/way
            way = raw - s[own + 1]
            s[own] -= (_sign(way) - s[own]) * math.expm1(-abs(way) / size)
            s[own + 1] = raw
        else:
            s[own] = min(max(s[own], raw - size), raw + size)


@kernel
def outside(p: Floats, u: Instant) -> bool:
    """Whether an input is so far beyond the range that half the effect is faded out, or more."""
    for i in range(int(p[_COUNT])):
        at = _FIRST + i * _EACH
        if _left(p[at + _LOW], p[at + _HIGH], _raw(p[at + _CODE], u)) < 0.5:
            return True
    return False


_KERNELS: Mapping[Slot, Callable[[Floats, Floats, Instant, float], float]] = {
    slot: _kernel for slot in WHERE.values()
}

EFFECT = Effect(
    id="empirical",
    title="Empirical law",
    kind=Kind.STRUCTURE,
    slot=Slot.TORQUE,
    stage=9,
    equation="g = size · S₁(u₁) · S₂(u₂), or a table over u₁ and u₂; nothing beyond its range",
    parameters=(
        Parameter("form", "1", 0, 1, f"one of {', '.join(FORMS)}"),
        Parameter("where", "1", 0, 1, f"one of {', '.join(WHERE)}"),
        Parameter("how", "1", 0, 1, "sum: g is added there; factor: a relative change", 0.0),
        Parameter("inputs", "1", 0, 1, f"one or two of {', '.join(INPUTS)}"),
        Parameter("shapes", "1", 0, 1, f"of a law, one each: {', '.join(SHAPES)}", 0.0),
        Parameter("memory", "1", 0, 1, f"one each: {', '.join(MEMORIES)}", 0.0),
        Parameter("range", "1", 0, 1, "{input: [lowest, highest]} that was seen", 0.0),
        Parameter("size", "1", -1e12, 1e12, "of a law: factor before the shapes", 0.0),
        *(
            Parameter(f"{name}_{i}", "1", -1e12, 1e12, f"{name} of input {i}", 0.0)
            for i in (1, 2)
            for name in NUMBERS
        ),
        Parameter("knots", "1", 0, 1, "of a curve or map: a list of numbers for each input", 0.0),
        Parameter("values", "1", 0, 1, "at the knots; of a map a row for each first knot", 0.0),
        Parameter("law", "1", 0, 1, "the same for people; not read", 0.0),
    ),
    sentence="Something is left that has no name of its own: {law}.",
    slots=_KERNELS,
    advance=remember,
    outside=outside,
    read=read,
    numbers=numbers,
    slot_of=slot_of,
)
