"""A law that was found, as the text of a catalogue file (``eps_hil/physics/effects/``), for review.

The file holds the same torque as the ``empirical`` entry does: shapes, memory, and the range beyond
which it fades. Numbers become parameters with bounds a decade wide, which a reviewer narrows.
"""

import keyword
import math
from collections.abc import Mapping
from typing import Any

from eps_hil.diagnosis.remainder.words import formula, sentence
from eps_hil.physics.effects.effect import Slot
from eps_hil.physics.effects.empirical import FADE
from eps_hil.physics.empirical_entry import NUMBERS, OF_SHAPE, SIGNS, WHERE
from eps_hil.unit_words import spaced

Entry = Mapping[str, Any]

_TURNING = "u.speed_rad_s / math.hypot(u.speed_rad_s, 0.5)"
_INPUTS: Mapping[str, tuple[str, str]] = {
    "motor_speed_rad_s": ("u.speed_rad_s", "rad/s"),
    "abs_motor_speed_rad_s": ("abs(u.speed_rad_s)", "rad/s"),
    "motor_angle_rad": ("u.angle_rad", "rad"),
    "rack_position_m": ("u.position_m", "m"),
    "motor_torque_nm": ("u.motor_torque_nm", "Nm"),
    "abs_motor_torque_nm": ("abs(u.motor_torque_nm)", "Nm"),
    "torque_sensor_nm": ("u.torque_sensor_nm", "Nm"),
    "abs_torque_sensor_nm": ("abs(u.torque_sensor_nm)", "Nm"),
    "rack_force_n": ("u.rack_force_n", "N"),
    "abs_rack_force_n": ("abs(u.rack_force_n)", "N"),
    "time_s": ("u.time_s", "s"),
    "since_reversal_s": ("0.0", "s"),
    "motor_power_sign": (f"_sign(u.motor_torque_nm) * {_TURNING}", "1"),
    "load_power_sign": (f"-_sign(u.rack_force_n) * {_TURNING}", "1"),
    "torque_sensor_power_sign": (f"_sign(u.torque_sensor_nm) * {_TURNING}", "1"),
    "motor_power_w": ("u.motor_torque_nm * u.speed_rad_s", "W"),
    "abs_motor_power_w": ("abs(u.motor_torque_nm * u.speed_rad_s)", "W"),
}
"""How a kernel reads an input, and its unit."""
_SHAPES: Mapping[str, str] = {
    "one": "1.0",
    "linear": "{x}",
    "square": "{x} * {x}",
    "saturating": "math.tanh({x} / {width})",
    "above": "max({x} - {centre}, 0.0)",
    "below": "max({centre} - {x}, 0.0)",
    "gaussian": "math.exp(-min((({x} - {centre}) / {width}) ** 2, 60.0))",
    "sine": "math.sin({order} * {x} + {phase})",
    "exponential": "math.exp(min(max(-({x} - {centre}) / {width}, -60.0), 20.0))",
    "step": "1.0 / (1.0 + math.exp(-min(max(({x} - {centre}) / {width}, -40.0), 40.0)))",
    "rational": "1.0 / (1.0 + ({x} / {width}) ** 2)",
}
_POWER = {"linear": 1, "square": 2, "above": 1, "below": 1}
_SINCE = """\
    way = _sign(u.speed_rad_s)
    s[{a}] += dt
    if way != 0.0 and way != s[{b}]:
        s[{a}], s[{b}] = 0.0, way
"""
_HEAT = "    s[{a}] -= (({x}) ** 2 - s[{a}]) * math.expm1(-dt / {n})\n"
_BEGIN = """\
    x = {x}
    if s[{c}] == 0.0:  # before the first sample nothing has happened
        s[{a}], s[{b}], s[{c}] = {start}, x, 1.0
"""
_MEMORIES: Mapping[str, str] = {
    "lag": "    else:\n        s[{a}] -= (x - s[{a}]) * math.expm1(-dt / {n})\n",
    "play": "    else:\n        s[{a}] = min(max(s[{a}], x - {n}), x + {n})\n",
    "stop": "    else:\n        s[{a}] = min(max(s[{a}], x - {n}), x + {n})\n",
    "hysteresis": "    else:\n        way = x - s[{b}]\n"
    "        s[{a}] -= (_sign(way) - s[{a}]) * math.expm1(-abs(way) / {n})\n        s[{b}] = x\n",
}
_SIGN = """

@kernel
def _sign(value: float) -> float:
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)
"""
_LEFT = f"""

@kernel
def _left(x: float, low: float, high: float) -> float:
    \"\"\"Share of the effect at ``x``: 1 in the range that was seen, fading out beyond it.\"\"\"
    return min(max(1.0 - max(low - x, x - high) / ({FADE} * (high - low)), 0.0), 1.0)
"""
_OUTSIDE = """

@kernel
def _outside(_p: Floats, u: Instant) -> bool:
    return {tests}
"""
_MODULE = '''\
"""{sentence}.

    {law}

Found in recordings by `eps-hil diagnose`; name, bounds and twins are for a reviewer to settle.
"""

import math

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import (
    Effect,
    Floats,
    Instant,
    Kind,
    Parameter,
    Probe,
    Slot,
{resolved})
{helpers}

@kernel
def _kernel(p: Floats, s: Floats, u: Instant, value: float) -> float:
{kernel}
{outside}

{advance}
EFFECT = Effect(
    id="{id}",
    kind=Kind.STRUCTURE,
    slot=Slot.{slot},
    stage=9,
    equation="{law}",
    parameters=(
{parameters}
    ),
    sentence="{plain}: size {{size:.3g}}{unit}.",
    kernel=_kernel,
{advances}{ends}    probe=Probe("size", 0.0, {step:.3g}, ({{{shapes}}},){phase}),
)
'''


def as_effect(entry: Entry, name: str) -> str:
    """The text of ``name``.py for a law; ``ValueError`` where there is none, or for a bad name."""
    if not name.isidentifier() or keyword.iskeyword(name):
        raise ValueError(f"'{name}' cannot be the name of an effect: letters, digits and _ only")
    law = formula(entry)
    if law is None:
        raise ValueError("what was found is a curve or map, no law: the model file holds it")
    numbers = free_numbers(entry)
    place = {key: repr(value) for key, value in numbers_of(entry).items()}
    place |= {key: f"p[{k}]" for k, key in enumerate(numbers)}
    kernel, remembers = _kernel(entry, place)
    body = "".join(remembers)
    advance = ""
    if body:
        head = "def _advance(p: Floats, s: Floats, u: Instant, dt: float) -> None:"
        advance = f"@kernel\n{head}\n{body}\n\n"
    outside = _outside(entry)
    used = kernel + body + outside
    helpers = (_SIGN if "_sign(" in used else "") + (_LEFT if "_left(" in used else "")
    phase = next((key for key in numbers if key.startswith("phase")), None)
    shapes = {k: v for k, v in numbers.items() if k != "size" and not k.startswith("phase")}
    return _MODULE.format(
        sentence=_capital(sentence(entry).split(":")[0]),
        law=law,
        helpers=helpers,
        resolved="    resolved,\n" if "resolved(" in used else "",
        kernel=kernel.rstrip("\n"),
        outside=outside.rstrip("\n"),
        ends="    outside=_outside,\n" if outside else "",
        advance=advance,
        id=name,
        slot=_slot(entry),
        parameters="\n".join(_parameter(entry, key, value) for key, value in numbers.items()),
        plain=_capital(sentence(entry).split(":")[0]),
        advances="    advance=_advance,\n" if body else "",
        unit=spaced(_unit(entry)),
        step=0.1 * abs(numbers["size"]),
        shapes=", ".join(f'"{key}": {value!r}' for key, value in shapes.items()),
        phase=f', phase="{phase}"' if phase else "",
    )


def _capital(words: str) -> str:
    """With a capital letter first; symbols stay as they are."""
    return words[:1].upper() + words[1:]


def _slot(entry: Entry) -> str:
    return Slot(WHERE[entry["where"]]).name


def numbers_of(entry: Entry) -> dict[str, float]:
    """Size, then what each input's shape and memory need, as an entry names them."""
    found = {"size": float(entry["size"])}
    for i, (shape, memory) in enumerate(zip(entry["shapes"], entry["memory"], strict=True), 1):
        wanted = [*OF_SHAPE[shape], *(["memory"] if memory != "none" else [])]
        found |= {f"{one}_{i}": float(entry[f"{one}_{i}"]) for one in NUMBERS if one in wanted}
    return found


def free_numbers(entry: Entry) -> dict[str, float]:
    """The same without the centres of signs, which are -1 or 1."""
    fixed = [f"centre_{i}" for i, one in enumerate(entry["inputs"], 1) if one in SIGNS]
    return {key: value for key, value in numbers_of(entry).items() if key not in fixed}


def _kernel(entry: Entry, place: Mapping[str, str]) -> tuple[str, list[str]]:
    """Body of the kernel, and what each input adds to that of ``advance``."""
    lines, factors, shares, remembers = [], [place["size"]], [], []
    for i, (name, shape, memory) in enumerate(
        zip(entry["inputs"], entry["shapes"], entry["memory"], strict=True), 1
    ):
        x, own = _INPUTS[name][0], 3 * (i - 1)
        at = {"a": own, "b": own + 1, "c": own + 2, "x": x, "n": place.get(f"memory_{i}", "")}
        if name == "since_reversal_s":
            remembers.append(_SINCE.format(**at))
        elif memory == "heat":
            remembers.append(_HEAT.format(**at))
        elif memory != "none":
            begun = _BEGIN.format(**at, start="0.0" if memory == "hysteresis" else "x")
            remembers.append(begun + _MEMORIES[memory].format(**at))
        lines.append(f"    raw{i} = {x}\n")
        if name in entry.get("range", {}):
            low, high = entry["range"][name]
            shares.append(f"_left(raw{i}, {low!r}, {high!r})")
        seen = f"raw{i}"
        if memory == "stop":
            n = at["n"]
            lines.append(f"    x{i} = min(max((raw{i} - s[{own}]) / {n}, -1.0), 1.0)\n")
            lines.append(f"    x{i} = x{i} if s[{own + 2}] != 0.0 else 0.0\n")
            seen = f"x{i}"
        elif memory != "none" or name == "since_reversal_s":
            seen = f"s[{own}]"
        numbers = {
            one: place.get(f"{one}_{i}", "") for one in ("centre", "width", "order", "phase")
        }
        factor = _SHAPES[shape].format(x=seen, **numbers)
        if shape == "sine" and name == "motor_angle_rad":
            factor += f" * resolved({numbers['order']} * u.speed_rad_s)"
        if shape != "one":
            factors.append(factor if _POWER.get(shape) != 2 else f"({factor})")
    product = " * ".join(factors)
    lines += [f"    share = {' * '.join(shares)}\n"] if shares else []
    change = f"share * {product}" if shares else product
    if entry.get("how") == "factor":
        lines.append(f"    return value * (1.0 + {change})")
    else:
        lines.append(f"    return value + {change}")
    return "".join(lines), remembers


def _outside(entry: Entry) -> str:
    """Where half of it is faded out, or more: a live estimate is not valid there."""
    tests = [
        f"_left({_INPUTS[name][0]}, {low!r}, {high!r}) < 0.5"
        for name, (low, high) in entry.get("range", {}).items()
    ]
    return _OUTSIDE.format(tests=" or ".join(tests)) if tests else ""


def unit_of(entry: Entry, key: str) -> str:
    """Of one of a law's numbers, as ``numbers_of`` names them."""
    name, _, number = key.partition("_")
    i = int(number) - 1 if number else 0
    if key == "size":
        return _unit(entry)
    if name == "phase":
        return "rad"
    if name == "order":
        return "1"
    if name == "memory" and entry["memory"][i] in ("lag", "heat"):
        return "s"
    return _INPUTS[entry["inputs"][i]][1]


def _parameter(entry: Entry, key: str, value: float) -> str:
    name, _, number = key.partition("_")
    i = int(number) - 1 if number else 0
    unit = unit_of(entry, key)
    wide = 10.0 * max(abs(value), 1e-6)
    low, high, told = -wide, wide, f"{name} over {entry['inputs'][i]}"
    if key == "size":
        told = "how much of it there is"
    elif name == "phase":
        low, high = -math.pi, math.pi
    elif name in ("width", "order", "memory"):
        low, high = 0.1 * value, 10.0 * value
    if name == "memory":
        timed = entry["memory"][i] in ("lag", "heat")
        told = "time constant" if timed else "way over which it turns"
    return f'        Parameter("{key}", "{unit}", {low:.4g}, {high:.4g}, "{told}", {value!r}),'


def _unit(entry: Entry) -> str:
    """Of the size: what is left for it once every shape has its own."""
    under: dict[str, int] = {}
    for name, shape, memory in zip(entry["inputs"], entry["shapes"], entry["memory"], strict=True):
        unit = "1" if memory in ("stop", "hysteresis") else _INPUTS[name][1]
        if unit != "1" and shape in _POWER:
            twice = 2 if memory == "heat" else 1
            under[unit] = under.get(unit, 0) + twice * _POWER[shape]
    top = "1" if entry.get("how") == "factor" else "Nm"
    parts = [unit if n == 1 else f"({unit})^{n}" for unit, n in under.items()]
    return f"{top}/({' · '.join(parts)})" if parts else top
