"""Which signal of a database, or column of a table, is which canonical one: guesses, and how sure.

By the words of its name, its unit, and what it must not be about (set-points, limits, estimates).
A database says nothing about signs; a table's data do (``data_signs``).
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from eps_hil.bus import units
from eps_hil.signals import CANONICAL

Floats = npt.NDArray[np.float64]

_MOTOR = ("motor", "mot", "rotor", "em", "assist")
_WHEEL = ("steeringwheel", "steering", "sw", "handwheel", "driver")
_WORDS: dict[str, tuple[tuple[str, ...], ...]] = {
    "motor_torque_nm": (_MOTOR, ("torque", "trq", "tq", "moment")),
    "torque_sensor_nm": (
        ("torsion", "torsionbar", "tbar", "column", "sensor", "driver", "hand", "steering"),
        ("torque", "trq", "tq", "moment"),
    ),
    "motor_speed_rad_s": (_MOTOR, ("speed", "spd", "velocity", "rpm", "omega")),
    "motor_angle_rad": (_MOTOR, ("angle", "ang", "position", "pos")),
    "rack_force_n": (("rack", "tierod", "rod", "load", "loadcell"), ("force", "cell", "f")),
    "rack_position_m": (("rack",), ("position", "pos", "travel", "displacement")),
    "steering_wheel_angle_rad": (_WHEEL, ("angle", "ang")),
    "steering_wheel_speed_rad_s": (_WHEEL, ("speed", "spd", "velocity", "rate")),
    "motor_temperature_degc": (_MOTOR, ("temperature", "temp")),
    "vehicle_speed_m_s": (("vehicle", "veh", "car"), ("speed", "spd", "velocity", "v")),
    "lateral_acceleration_m_s2": (("lateral", "lat"), ("acceleration", "acc", "accel")),
    "yaw_rate_rad_s": (("yaw",), ("rate", "speed", "velocity")),
}
"""One word of each group has to be in the name, one of them at least in the signal's own."""
_NEVER = (
    "setpoint", "set", "request", "requested", "target", "desired", "limit", "max", "min",
    "estimate", "applied", "commanded", "command", "status", "valid", "offset", "counter", "crc",
    "checksum", "suggested", "friction",
)  # fmt: skip
LEAST = 0.5
_BY_MESSAGE = 0.2
"""So much less sure where the message's name has to help: SpdAct of MotorStatus."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """Something that was measured: its name (with the message's), and its unit if it has one."""

    name: str
    unit: str | None
    message: str = ""


@dataclass(frozen=True, slots=True)
class Guess:
    """A candidate for one canonical signal; ``sure`` from 0 to 1, ``why`` for a person."""

    canonical: str
    of: Candidate
    scale: float
    sure: float
    why: str


def words(name: str) -> set[str]:
    """The words of an identifier, neighbours joined too: MotorSpeed_rpm, n_mot, TORSION_BAR."""
    split = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    parts = [one for one in re.split(r"[^A-Za-z]+", split.lower()) if one]
    return {*parts, *("".join(pair) for pair in pairwise(parts))}


def guess(candidates: Iterable[Candidate]) -> dict[str, Guess]:
    """The best candidate of each canonical signal, where there is one; each is used once."""
    offers = [
        one
        for candidate in candidates
        for canonical in _WORDS
        if (one := _offer(canonical, candidate)) is not None
    ]
    found: dict[str, Guess] = {}
    used: set[tuple[str, str]] = set()
    for one in sorted(offers, key=lambda offer: -offer.sure):
        place = (one.of.message, one.of.name)
        if one.canonical not in found and place not in used:
            rivals = [
                other
                for other in offers
                if other.canonical == one.canonical and other.sure > one.sure - 0.1
            ]
            shared = one.sure / len(rivals) ** 0.5
            found[one.canonical] = replace(one, sure=shared)
            used.add(place)
    return {name: found[name] for name in _WORDS if name in found}


def _offer(canonical: str, candidate: Candidate) -> Guess | None:
    there = words(candidate.name)
    if there & set(_NEVER):
        return None
    exact = candidate.name.lower() == canonical
    groups = _WORDS[canonical]
    around = words(candidate.message)
    hits = sum(bool(there & set(group)) for group in groups)
    by_message = sum(bool(around & set(group)) for group in groups if not there & set(group))
    wanted, known = units.quantity(CANONICAL[canonical].unit), units.known(candidate.unit)
    if not exact and (not hits or hits + by_message < len(groups)):
        return None
    if known is not None and known[0] != wanted:
        return None
    unit = candidate.unit or "no unit"
    if exact:
        return Guess(canonical, candidate, 1.0, 0.99, "the canonical name")
    extra = len(there - set().union(*map(set, groups)))
    base = (0.9 if known is not None else 0.55) - (_BY_MESSAGE if by_message else 0.0)
    name = "names of message and signal" if by_message else "name"
    said = (
        f"{name} and unit ({unit})" if known is not None else f"{name}; unit '{unit}' is not known"
    )
    return Guess(canonical, candidate, known[1] if known else 1.0, base - 0.02 * extra, said)


def data_signs(columns: Mapping[str, Floats], time_s: Floats) -> dict[str, tuple[int, float]]:
    """Sign of each signal against speed and motor torque by the data: (±1, |correlation|).

    Angles turn with the speed; torsion-bar torque and rack force grow with the motor torque, which
    assists the one against the other (CONTRACT 1). Signals that the data say nothing of are left
    out.
    """
    found: dict[str, tuple[int, float]] = {}
    speed, torque = columns.get("motor_speed_rad_s"), columns.get("motor_torque_nm")
    if speed is not None and "motor_angle_rad" in columns:
        rate = np.gradient(columns["motor_angle_rad"], time_s)
        _put(found, "motor_angle_rad", rate, speed)
    for name in ("rack_force_n", "torque_sensor_nm"):
        if torque is not None and name in columns:
            _put(found, name, columns[name], torque)
    return found


def _put(found: dict[str, tuple[int, float]], name: str, one: Floats, other: Floats) -> None:
    good = np.isfinite(one) & np.isfinite(other)
    if np.count_nonzero(good) > 100 and np.std(one[good]) > 0 and np.std(other[good]) > 0:
        r = float(np.corrcoef(one[good], other[good])[0, 1])
        if abs(r) > 0.3:
            found[name] = (1 if r > 0 else -1, abs(r))
