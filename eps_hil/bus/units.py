"""Units as databases write them: which quantity they measure, and the factor to the SI unit."""

import math

_DEGREE = math.pi / 180.0
_TABLE: dict[str, tuple[str, float]] = {
    "nm": ("torque", 1.0), "n-m": ("torque", 1.0), "mnm": ("torque", 1e-3),
    "mn-m": ("torque", 1e-3), "cnm": ("torque", 1e-2), "knm": ("torque", 1e3),
    "unm": ("torque", 1e-6), "µnm": ("torque", 1e-6), "μnm": ("torque", 1e-6),
    "rad/s": ("angular speed", 1.0), "rpm": ("angular speed", math.pi / 30.0),
    "u/min": ("angular speed", math.pi / 30.0), "rev/min": ("angular speed", math.pi / 30.0),
    "1/min": ("angular speed", math.pi / 30.0), "min-1": ("angular speed", math.pi / 30.0),
    "deg/s": ("angular speed", _DEGREE), "°/s": ("angular speed", _DEGREE),
    "rad": ("angle", 1.0), "deg": ("angle", _DEGREE), "°": ("angle", _DEGREE),
    "degree": ("angle", _DEGREE), "degrees": ("angle", _DEGREE),
    "n": ("force", 1.0), "kn": ("force", 1e3), "dan": ("force", 10.0),
    "m": ("length", 1.0), "mm": ("length", 1e-3), "cm": ("length", 1e-2),
    "m/s": ("speed", 1.0), "km/h": ("speed", 1 / 3.6), "kph": ("speed", 1 / 3.6),
    "kmh": ("speed", 1 / 3.6), "mph": ("speed", 0.44704),
    "m/s^2": ("acceleration", 1.0), "m/s2": ("acceleration", 1.0), "m/s²": ("acceleration", 1.0),
    "g": ("acceleration", 9.80665),
    "degc": ("temperature", 1.0), "°c": ("temperature", 1.0), "c": ("temperature", 1.0),
    "a": ("current", 1.0), "ma": ("current", 1e-3), "v": ("voltage", 1.0),
}  # fmt: skip
_TIMES = " .*·⋅∙•\t"
_OF_CANONICAL = {
    "Nm": "torque", "rad/s": "angular speed", "rad": "angle", "N": "force", "m": "length",
    "m/s": "speed", "m/s^2": "acceleration", "degC": "temperature",
}  # fmt: skip


_MILLI = frozenset({"mnm", "mn-m", "mm", "ma"})


def known(unit: str | None) -> tuple[str, float] | None:
    """(quantity, factor to SI) of a unit as somebody wrote it; None if it is not known.

    Nor is one that may be mega or milli (:func:`ambiguous`).
    """
    return None if ambiguous(unit) else _TABLE.get(_plain(unit).lower())


def ambiguous(unit: str | None) -> bool:
    """Whether a unit (``MNm``, ``MM``) is mega by its letters, and milli where case says nothing.

    The two are a factor of 1e9 apart; of all other prefixes here only one case is in use.
    """
    plain = _plain(unit)
    return plain.startswith("M") and plain.lower() in _MILLI


def _plain(unit: str | None) -> str:
    return "".join(each for each in unit or "" if each not in _TIMES)


def torque_nm(unit: str | None) -> float | None:
    """Nm of 1 of a unit of torque; None for every other unit."""
    quantity, factor = known(unit) or ("", 0.0)
    return factor if quantity == "torque" else None


def quantity(canonical_unit: str) -> str:
    """The quantity that a canonical signal's unit measures."""
    return _OF_CANONICAL[canonical_unit]
