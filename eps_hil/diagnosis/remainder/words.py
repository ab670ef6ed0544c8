"""A law as a formula and a sentence, and the physics of the field that it is like."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

SYMBOLS: Mapping[str, str] = {
    "motor_speed_rad_s": "ω",
    "abs_motor_speed_rad_s": "|ω|",
    "motor_angle_rad": "φ",
    "rack_position_m": "x",
    "motor_torque_nm": "T_em",
    "abs_motor_torque_nm": "|T_em|",
    "torque_sensor_nm": "T_sen",
    "abs_torque_sensor_nm": "|T_sen|",
    "rack_force_n": "F",
    "abs_rack_force_n": "|F|",
    "time_s": "t",
    "since_reversal_s": "t_rev",
    "motor_power_sign": "sign(T_em·ω)",
    "load_power_sign": "sign(-F·ω)",
    "torque_sensor_power_sign": "sign(T_sen·ω)",
    "motor_power_w": "T_em·ω",
    "abs_motor_power_w": "|T_em·ω|",
}
_PLACES: Mapping[tuple[str, str], str] = {
    ("rotor", "sum"): "T_f {}",
    ("friction", "sum"): "T_fs {}",
    ("friction", "factor"): "T_fs · (1 {})",
    ("motor", "sum"): "T_em {}",
    ("motor", "factor"): "T_em · (1 {})",
    ("load", "factor"): "F/i_APA · (1 {})",
    ("torsion_bar", "factor"): "T_sen · (1 {})",
}
PLAIN: Mapping[str, str] = {
    "rotor": "a torque against the rotor",
    "friction": "friction",
    "motor": "the motor's torque",
    "load": "what the rack force is worth at the rotor",
    "torsion_bar": "the torsion bar's torque",
}
_POWERS: Mapping[str, tuple[str, str]] = {
    "motor_power_sign": ("[T_em·ω > 0]", "[T_em·ω < 0]"),
    "load_power_sign": ("[F·ω < 0]", "[F·ω > 0]"),
    "torque_sensor_power_sign": ("[T_sen·ω > 0]", "[T_sen·ω < 0]"),
}
"""One where a power has that sign, else nothing (Iverson's brackets): shapes above and below 0."""
Entry = Mapping[str, Any]


def formula(entry: Entry) -> str | None:
    """The law of an entry (``effects/empirical.py``) written out; None for a curve or map."""
    if "values" in entry:
        return None
    factors, memories = [], []
    for i, (name, shape, memory) in enumerate(
        zip(entry["inputs"], entry["shapes"], entry["memory"], strict=True), 1
    ):
        seen = SYMBOLS[name]
        if memory != "none":
            kept = f"h{i}" if len(entry["inputs"]) > 1 else "h"
            memories.append(_memory(memory, kept, seen, float(entry[f"memory_{i}"])))
            seen = kept
        if name in _POWERS and shape in ("above", "below") and entry[f"centre_{i}"] == 0.0:
            factors.append(_POWERS[name][shape == "below"])
        else:
            factors.append(_shape(shape, seen, entry, i))
    size = _added(float(entry["size"]), 4)
    whole = _PLACES[entry["where"], entry["how"]].format(" · ".join([size, *filter(None, factors)]))
    return ", ".join([whole, *memories])


def _memory(memory: str, kept: str, seen: str, number: float) -> str:
    equations = {
        "lag": f"{number:.3g} s · d{kept}/dt = {seen} − {kept}",
        "heat": f"{number:.3g} s · d{kept}/dt = {seen}² − {kept}",
        "play": f"{kept} follows {seen} past a play of ±{number:.3g}",
        "stop": f"{kept} = {seen} over {number:.3g}, held between -1 and 1",
        "hysteresis": f"{number:.3g} · d{kept} = d{seen} − |d{seen}| · {kept}",
    }
    return equations[memory]


def _shape(shape: str, seen: str, entry: Entry, i: int) -> str:
    centre, width = (float(entry.get(f"{one}_{i}", 0.0)) for one in ("centre", "width"))
    order, phase = (float(entry.get(f"{one}_{i}", 0.0)) for one in ("order", "phase"))
    away = f"{seen} {_added(-centre)}"
    off = seen if centre == 0.0 else f"({away})"
    return {
        "one": "",
        "linear": seen,
        "square": f"{seen}²",
        "saturating": f"tanh({seen}/{width:.3g})",
        "above": f"max({away}, 0)",
        "below": f"max({centre:.3g} − {seen}, 0)",
        "gaussian": f"exp(−({off}/{width:.3g})²)",
        "sine": f"sin({order:.4g}·{seen} {_added(phase)})",
        "exponential": f"exp(−{off}/{width:.3g})",
        "step": f"1/(1 + exp(−{off}/{width:.3g}))",
        "rational": f"1/(1 + ({seen}/{width:.3g})²)",
    }[shape]


def _added(value: float, digits: int = 3) -> str:
    """``+ 0.5`` or ``− 0.5``."""
    return f"{'−' if value < 0.0 else '+'} {abs(value):.{digits}g}"


def sentence(entry: Entry) -> str:
    """What an entry says, for a rig engineer."""
    names = " and ".join(dict.fromkeys(SYMBOLS[name] for name in entry["inputs"]))
    where = PLAIN[entry["where"]]
    law = formula(entry)
    if law is not None:
        return f"{where} changes with {names}: {law}"
    kind = "curve" if len(entry["inputs"]) == 1 else "map"
    return f"{where} changes with {names} by a {kind} that is no simple law"


def _has(entry: Entry, name: str, shapes: Sequence[str] = (), memory: Sequence[str] = ()) -> bool:
    if "values" in entry:
        return name in entry["inputs"] and not memory
    return any(
        one.removeprefix("abs_") == name
        and (not shapes or shape in shapes)
        and (kept in memory if memory else kept == "none")
        for one, shape, kept in zip(entry["inputs"], entry["shapes"], entry["memory"], strict=True)
    )


def _at(entry: Entry, *where: str) -> bool:
    return entry["where"] in where


_SPEED, _TORQUE, _SENSOR = "motor_speed_rad_s", "motor_torque_nm", "torque_sensor_nm"
_ANGLE, _FORCE, _PLACE = "motor_angle_rad", "rack_force_n", "rack_position_m"
_FALLING = ("above", "step", "square", "linear", "rational", "exponential")
_WAYS = ("stop", "hysteresis", "play")
_WARMS_S = 3.0
"""A lubricant's film settles in less, its heat takes longer."""


def _warms(entry: Entry) -> bool:
    """Friction that falls with what was rubbed, pressed or turned over lately."""
    slow = [
        float(entry[f"memory_{i}"]) >= _WARMS_S
        for i, memory in enumerate(entry["memory"], 1)
        if memory in ("lag", "heat")
    ]
    return any(slow) and entry["shapes"][-1] in ("linear", "saturating") and entry["size"] < 0.0


def _signed(entry: Entry) -> bool:
    """Whether a torque, or the load, times the sign of its own power: its size times the speed's
    sign, where it drives or where it brakes."""
    of = {
        "motor_power_sign": _TORQUE,
        "load_power_sign": _FORCE,
        "torque_sensor_power_sign": _SENSOR,
    }
    return any(of.get(one) in entry["inputs"] for one in entry["inputs"])


def _proportional(entry: Entry, name: str) -> bool:
    """Whether a torque at the rotor grows with one signal and nothing else.

    The catalogue holds such effects; where one stands as a law, the model's own numbers could
    nearly do what it does, or the search had no turn of its own for it.
    """
    return (
        _at(entry, "rotor")
        and entry.get("how") == "sum"
        and list(entry["inputs"]) == [name]
        and entry.get("shapes") == ["linear"]
        and list(entry["memory"]) == ["none"]
    )


_KNOWN: Sequence[tuple[str, str, Callable[[Entry], bool]]] = (
    ("load cell that reads too much or too little", "the rack force is worth another share",
     lambda e: _at(e, "load") and e.get("shapes") == ["one"]),
    ("inverter dead time", "a voltage that is lost each switching, with the sign of the current",
     lambda e: _at(e, "motor", "rotor") and _has(e, _TORQUE, ("saturating",))),
    ("current fold-back", "motor torque falls with the heat of T²",
     lambda e: _at(e, "motor") and _has(e, _TORQUE, memory=("heat",))),
    ("field weakening", "motor torque falls with speed",
     lambda e: _at(e, "motor") and e.get("how") == "factor" and _has(e, _SPEED, _FALLING)),
    ("mesh efficiency, driving against driven", "flanks rub by torque and by who drives whom",
     lambda e: any(n in _POWERS for n in e["inputs"])
     and (_at(e, "friction") or (_at(e, "rotor") and _signed(e)))),
    ("unbalance", "a torque once a turn that grows with speed squared",
     lambda e: _at(e, "rotor") and _has(e, _SPEED, ("square",)) and _has(e, _ANGLE, ("sine",))),
    ("rack-guide friction", "friction grows with the torque at the pinion, which lifts the rack",
     lambda e: _at(e, "friction") and _has(e, _SENSOR)),
    ("grease that warms", "friction falls with the heat of motion",
     lambda e: _at(e, "friction") and (_warms(e) or _has(e, _SPEED, memory=("heat",)))),
    ("velocity-memory friction", "the lubricant film follows speed late",
     lambda e: _at(e, "friction") and _has(e, _SPEED, memory=("lag",))),
    ("friction that follows the load late", "contacts settle under load",
     lambda e: _at(e, "friction") and _has(e, _FORCE, memory=("lag",))),
    ("torque ripple of another order", "motor torque ripples with the angle",
     lambda e: _at(e, "motor") and _has(e, _ANGLE, ("sine",))),
    ("ripple that grows with the load", "a tooth or ball error under force",
     lambda e: _at(e, "rotor") and _has(e, _FORCE) and _has(e, _ANGLE, ("sine",))),
    ("hysteretic bushing (Bouc–Wen)", "a torque that turns round over a way of its own",
     lambda e: _at(e, "rotor") and _has(e, _ANGLE, memory=_WAYS)),
    ("iron losses with play in torque", "motor torque lags behind current by a hysteresis",
     lambda e: _at(e, "motor", "rotor") and _has(e, _TORQUE, memory=_WAYS)),
    ("position-dependent damping", "a drag that changes over the travel",
     lambda e: _at(e, "rotor", "friction") and _has(e, _SPEED, ("linear",)) and _has(e, _PLACE)),
    ("iron losses of the motor", "motor torque falls with the power that it turns over",
     lambda e: _at(e, "motor") and e.get("how") == "factor"
     and e["inputs"][0] == "abs_motor_power_w"),
    ("damage in one place", "a ripple of the teeth or balls over a part of the travel",
     lambda e: _at(e, "rotor") and _has(e, _PLACE, ("gaussian",)) and _has(e, _ANGLE, ("sine",))),
    ("eddy-current brake", "a drag that has a peak over speed",
     lambda e: _at(e, "rotor") and _has(e, _SPEED, ("rational",))),
    ("thrust bearing under load", "friction grows beyond a force, in one direction of it",
     lambda e: _at(e, "friction") and _has(e, _FORCE, ("above", "below"))),
    ("motor that gives another share of what it reports", "its torque is worth another factor",
     lambda e: _proportional(e, _TORQUE)),
    ("torsion bar that reads too much or too little", "its torque is worth another factor",
     lambda e: _proportional(e, _SENSOR)),
    ("spring", "a torque that grows with the way from the middle",
     lambda e: _proportional(e, _PLACE) or _proportional(e, _ANGLE)),
    ("drag in proportion to speed", "a viscous friction that the model has not",
     lambda e: _proportional(e, _SPEED)),
)  # fmt: skip


def resembles(entry: Entry) -> list[dict[str, str]]:
    """The families of the field that an entry is like, most telling first; a map is like none."""
    if "values" in entry and len(entry["inputs"]) > 1:
        return []
    return [{"what": what, "why": why} for what, why, like in _KNOWN if like(entry)]
