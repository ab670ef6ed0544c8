"""How a model file writes what was found in recordings, and how compiled code is given it.

Read and written for ``effects/empirical.py``, whose docstring has the equations. Every mistake is a
``ValueError`` that names the key and what was expected.
"""

import math
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any, NamedTuple

from eps_hil.physics.effects.effect import WIDTH, Slot

FORMS = ("law", "curve", "map", "dynamic")
WHERE: Mapping[str, Slot] = {
    "rotor": Slot.TORQUE,
    "friction": Slot.LEVEL,
    "motor": Slot.MOTOR,
    "load": Slot.LOAD,
    "torsion_bar": Slot.SENSOR,
}
"""Torque that opposes the drive, T_fs, motor torque, F/i_APA, true torsion-bar torque."""
HOW = ("sum", "factor")
INPUTS = (
    "motor_speed_rad_s",
    "abs_motor_speed_rad_s",
    "motor_angle_rad",
    "rack_position_m",
    "motor_torque_nm",
    "abs_motor_torque_nm",
    "torque_sensor_nm",
    "abs_torque_sensor_nm",
    "rack_force_n",
    "abs_rack_force_n",
    "time_s",
    "since_reversal_s",
    "motor_power_sign",
    "load_power_sign",
    "torque_sensor_power_sign",
    "motor_power_w",
    "abs_motor_power_w",
)
"""Signals of CONTRACT 2, their sizes (abs_…), whether a torque drives (1) or brakes (-1), and the
motor's power."""
SIGNS = tuple(one for one in INPUTS if one.endswith("_power_sign"))
SHAPES = (
    "one",
    "linear",
    "square",
    "saturating",
    "above",
    "below",
    "gaussian",
    "sine",
    "exponential",
    "step",
    "rational",
)
MEMORIES = ("none", "lag", "heat", "play", "stop", "hysteresis")
NUMBERS = ("centre", "width", "order", "phase", "memory")
"""Of each input: keys ``centre_1``, …; ``memory`` is a time in s (lag, heat), or a way in the
input's unit (play, stop, hysteresis)."""
OF_SHAPE: Mapping[str, tuple[str, ...]] = {
    "one": (),
    "linear": (),
    "square": (),
    "saturating": ("width",),
    "above": ("centre",),
    "below": ("centre",),
    "gaussian": ("centre", "width"),
    "sine": ("order", "phase"),
    "exponential": ("centre", "width"),
    "step": ("centre", "width"),
    "rational": ("width",),
}
"""Numbers that a shape needs."""

_FIRST, _EACH = 4, 10
_TABLE_AT = _FIRST + 2 * _EACH
_ROOM = WIDTH - _TABLE_AT - 2
_NO_RANGE = (1.0, -1.0)


class _Table(NamedTuple):
    knots: tuple[tuple[float, ...], ...]
    values: tuple[float, ...]


def read(entry: Mapping[str, Any]) -> dict[str, Any]:
    """An entry of a model file, checked; ``ValueError`` says which key is wrong."""
    form = _one_of(entry, "form", FORMS)
    where = _one_of(entry, "where", tuple(WHERE))
    how = _one_of({"how": "sum", **entry}, "how", HOW)
    inputs = _names(entry, "inputs", INPUTS)
    if not 1 <= len(inputs) <= 2:
        raise ValueError(f"empirical.inputs has {len(inputs)} names, expected one or two")
    memory = _names({"memory": ["none"] * len(inputs), **entry}, "memory", MEMORIES)
    table = form in ("curve", "map") or (form == "dynamic" and "values" in entry)
    shapes = ["one"] * len(inputs) if table else _names(entry, "shapes", SHAPES)
    for name, given in (("memory", memory), ("shapes", shapes)):
        if len(given) != len(inputs):
            raise ValueError(f"empirical.{name} has {len(given)} names, {len(inputs)} expected")
    needed = {"size"} if not table else set()
    for i, (shape, kept) in enumerate(zip(shapes, memory, strict=True), 1):
        needed |= {f"{name}_{i}" for name in OF_SHAPE[shape]}
        needed |= {f"memory_{i}"} if kept != "none" else set()
    optional = {"size"} if table else set()
    others = {"effect", "form", "where", "how", "inputs", "memory", "shapes", "range", "law"}
    others |= {"knots", "values"} if table else set()
    for key in entry:
        if key not in needed | optional | others:
            raise ValueError(f"empirical has no '{key}' beside form {form} and these shapes")
    numbers = {key: _number(entry, key) for key in sorted(needed)}
    if table:
        numbers["size"] = _number({"size": 1.0, **entry}, "size")
    for key, value in numbers.items():
        if key.startswith(("width", "memory")) and value <= 0.0:
            raise ValueError(f"empirical.{key} is {value}, expected more than zero")
    return {
        "form": form,
        "where": where,
        "how": how,
        "inputs": tuple(inputs),
        "memory": tuple(memory),
        "shapes": tuple(shapes),
        "range": _ranges(entry, inputs),
        **numbers,
        **({"table": _table(entry, len(inputs))} if table else {}),
    }


def numbers(values: Mapping[str, Any]) -> list[float]:
    """What :func:`read` gave, packed as the kernel takes it."""
    table: _Table | None = values.get("table")
    packed = [float(HOW.index(values["how"])), 0.0 if table is None else 1.0,
              float(len(values["inputs"])), values["size"]]  # fmt: skip
    for i in range(2):
        if i >= len(values["inputs"]):
            packed += [0.0] * _EACH
            continue
        name = values["inputs"][i]
        packed += [float(INPUTS.index(name)), float(MEMORIES.index(values["memory"][i]))]
        packed += [values.get(f"memory_{i + 1}", 0.0), float(SHAPES.index(values["shapes"][i]))]
        packed += [values.get(f"{one}_{i + 1}", 0.0) for one in NUMBERS[:4]]
        packed += [*values["range"].get(name, _NO_RANGE)]
    if table is not None:
        first, second = table.knots[0], table.knots[1] if len(table.knots) > 1 else ()
        packed += [float(len(first)), float(len(second)), *first, *second, *table.values]
    return packed


def _one_of(entry: Mapping[str, Any], key: str, known: Sequence[str]) -> str:
    value = entry.get(key)
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"empirical.{key} is {value!r}, expected one of {', '.join(known)}")
    return value


def _names(entry: Mapping[str, Any], key: str, known: Sequence[str]) -> list[str]:
    given = entry.get(key)
    if not isinstance(given, list | tuple) or not given:
        raise ValueError(f"empirical needs {key}, a list of names")
    for name in given:
        if name not in known:
            near = get_close_matches(str(name), known, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}"
            raise ValueError(f"empirical.{key}: '{name}' is not known; {hint}")
    return [str(name) for name in given]


def _number(entry: Mapping[str, Any], key: str) -> float:
    value = entry.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"empirical.{key} is {value!r}, a finite number was expected")
    return float(value)


def _ranges(entry: Mapping[str, Any], inputs: Sequence[str]) -> dict[str, tuple[float, float]]:
    given = entry.get("range", {})
    if not isinstance(given, Mapping):
        raise ValueError("empirical.range is no mapping of inputs to [lowest, highest]")
    found = {}
    for name, ends in given.items():
        if name not in inputs:
            raise ValueError(f"empirical.range: '{name}' is none of its inputs")
        try:
            low, high = (float(end) for end in ends)
        except (TypeError, ValueError):
            raise ValueError(f"empirical.range.{name} is {ends!r}, expected two numbers") from None
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError(f"empirical.range.{name} is {ends!r}, expected [lower, higher]")
        found[name] = (low, high)
    return found


def _table(entry: Mapping[str, Any], count: int) -> _Table:
    """``knots``: a list for each input; ``values``: one for each knot, or a list of such rows."""
    try:
        knots = tuple(tuple(float(x) for x in axis) for axis in entry["knots"])
        rows = entry["values"] if count == 2 else [entry["values"]]
        values = [[float(value) for value in row] for row in rows]
    except (KeyError, TypeError, ValueError):
        raise ValueError(
            "empirical needs knots (a list of numbers for each input) and values"
        ) from None
    lengths = [len(axis) for axis in knots]
    expected = [[lengths[0]], [1, lengths[0]]] if count == 1 else [lengths, lengths]
    shape = [len(values), len(values[0])] if values else [0]
    if len(knots) != count or shape != expected[-1] or len({len(row) for row in values}) != 1:
        raise ValueError(f"empirical.values do not fit knots of {lengths}")
    numbers = [value for row in values for value in row]
    if any(len(axis) < 2 or list(axis) != sorted(set(axis)) for axis in knots):
        raise ValueError("empirical.knots: two or more rising numbers are expected for each input")
    if not all(math.isfinite(one) for one in (*numbers, *(x for axis in knots for x in axis))):
        raise ValueError("empirical.knots and values must be finite")
    if sum(lengths) + len(numbers) > _ROOM:
        raise ValueError(f"empirical has room for {_ROOM} knots and values together")
    return _Table(knots, tuple(numbers))


def slot_of(values: Mapping[str, Any]) -> Slot:
    """Where checked values act."""
    return WHERE[values["where"]]
