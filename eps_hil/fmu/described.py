"""An FMU's description: what it takes, gives and may be told, before anything of it runs."""

import zipfile
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eps_hil.bus import units
from eps_hil.errors import InputError
from eps_hil.fmu.variables import UNITS
from eps_hil.recordings.files import needs_extra, refused_by_system

_FLOATS = ("Real", "Float64")
_WHOLE = ("Integer", "Enumeration", *(f"{u}Int{n}" for u in ("", "U") for n in (8, 16, 32, 64)))
_OTHERS = (*_WHOLE, "Boolean", "Float32")


@dataclass(frozen=True, slots=True)
class FmuVariable:
    """One number of an FMU; ``to_si``: factor and offset to our unit, None where unknown.

    ``kind``: its type, as FMI calls it; ``begins``: its start, as the FMU writes it.
    """

    name: str
    reference: int
    causality: str
    unit: str
    quantity: str | None
    to_si: tuple[float, float] | None
    start: float | None
    bounds: tuple[float | None, float | None]
    meaning: str
    kind: str = "Real"
    begins: str = ""

    @property
    def whole(self) -> bool:
        """Whether it is an integer or the number of an item."""
        return self.kind in _WHOLE


@dataclass(frozen=True, slots=True)
class Described:
    """A co-simulation FMU; ``raw`` is FMPy's description of it.

    ``step_s``: of its default experiment; ``fixed_s``: of its own solver, whose multiples it takes.
    ``others``: switches and numbers that are no signals: booleans, integers, enumerations.
    """

    path: Path
    version: str
    variables: Mapping[str, FmuVariable]
    others: Mapping[str, FmuVariable]
    interpolates: bool
    any_step: bool
    step_s: float | None
    fixed_s: float | None
    raw: Any

    def of(self, *causalities: str) -> dict[str, FmuVariable]:
        """Its variables of these kinds."""
        return {n: one for n, one in self.variables.items() if one.causality in causalities}


def read_fmu(path: Path) -> Described:
    """Read an FMU's description; :class:`InputError` where it cannot be run here."""
    with needs_extra(path, "fmu"):
        import fmpy
    with refused_by_system(path), path.open("rb") as file:
        if not zipfile.is_zipfile(file):
            raise InputError(path, "", "is no FMU (a ZIP file)", "export it again")
    try:
        raw = fmpy.read_model_description(str(path), validate=False)
    except Exception as error:  # FMPy raises whatever its parsers do
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(path, "modelDescription.xml", said, "export it again") from None
    if raw.fmiVersion.split(".")[0] not in ("2", "3"):
        raise InputError(path, "", f"is FMI {raw.fmiVersion}, 2 or 3 was expected", "export anew")
    if raw.coSimulation is None:
        raise InputError(
            path, "", "is no co-simulation FMU", "export it with a solver in it (co-simulation)"
        )
    there = [one for one in fmpy.supported_platforms(str(path)) if one != "c-code"]
    if fmpy.platform not in there and fmpy.platform_tuple not in there:
        has = ", ".join(there) or "no binary"
        raise InputError(path, "binaries", f"has {has}, this machine needs {fmpy.platform}",
                         "export it for this platform")  # fmt: skip
    step = getattr(raw.defaultExperiment, "stepSize", None)
    fixed = raw.coSimulation.fixedInternalStepSize
    known = {one.name: one for one in raw.unitDefinitions or []}

    def of(kinds: Collection[str]) -> dict[str, FmuVariable]:
        return {one.name: _variable(one, known) for one in raw.modelVariables
                if one.type in kinds and not one.dimensions}  # fmt: skip

    return Described(
        path,
        raw.fmiVersion,
        of(_FLOATS),
        of(_OTHERS),
        bool(raw.coSimulation.canInterpolateInputs) and raw.fmiVersion.startswith("2"),
        bool(raw.coSimulation.canHandleVariableCommunicationStepSize),
        float(step) if step else None,
        float(fixed) if fixed else None,
        raw,
    )


def _variable(one: Any, known: Mapping[str, Any]) -> FmuVariable:
    declared = one.declaredType
    unit = one.unit or getattr(declared, "unit", None) or ""
    quantity, factor = _measures(unit, known)
    start = one.start
    return FmuVariable(
        one.name,
        one.valueReference,
        one.causality or "local",
        unit,
        quantity,
        factor,
        float(start) if isinstance(start, str | int | float) and _is_number(start) else None,
        (_bound(one.min, declared, "min"), _bound(one.max, declared, "max")),
        one.description or "",
        one.type,
        "" if start is None else str(start),
    )


_SI = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_Powers = tuple[tuple[str, int], ...]
_QUANTITIES: dict[_Powers, str] = {
    tuple(sorted(UNITS[unit][1].items())): quantity
    for unit, quantity in (("Nm", "torque"), ("N", "force"), ("m", "length"), ("rad", "angle"),
                           ("rad/s", "angular speed"))
} | {(("m", 1), ("s", -1)): "speed", (("m", 1), ("s", -2)): "acceleration",
     (("K", 1),): "temperature"}  # fmt: skip
_WITHOUT_RAD: dict[_Powers, str] = {(): "angle", (("s", -1),): "angular speed"}
"""What these powers may be where a tool leaves out the radian: then the unit's name decides."""
_ENERGY = ("J", "kJ", "MJ")
_KELVIN = 273.15


def _measures(unit: str, known: Mapping[str, Any]) -> tuple[str | None, Any]:
    """(quantity, (factor, offset) to SI); "something else" where it is known to be another.

    Temperatures are in degrees Celsius, as everywhere here.
    """
    base = getattr(known.get(unit), "baseUnit", None)
    named = units.known(unit)
    if base is None or unit in ("", "1"):
        if unit == "K":
            return "temperature", (1.0, -_KELVIN)
        return (None, None) if named is None else (named[0], (named[1], 0.0))
    powers = tuple(sorted((si, int(getattr(base, si))) for si in _SI if int(getattr(base, si))))
    factor, offset = float(base.factor), float(base.offset)
    if maybe := _WITHOUT_RAD.get(powers):
        if named is not None and named[0] == maybe:
            return maybe, (named[1], 0.0)
        says_nothing = unit in ("1/s", "s-1", "s^-1") if powers else factor == 1.0
        return (None, None) if says_nothing else ("something else", (factor, offset))
    quantity = "something else" if unit in _ENERGY else _QUANTITIES.get(powers, "something else")
    if quantity == "temperature":
        offset -= _KELVIN
    return quantity, (factor, offset)


def _bound(said: Any, declared: Any, which: str) -> float | None:
    """A variable's own bound, else that of its type (an inertia's 0)."""
    own = _number(said)
    return _number(getattr(declared, which, None)) if own is None else own


def _is_number(text: object) -> bool:
    return _number(text) is not None


def _number(text: Any) -> float | None:
    try:
        return float(text)
    except (TypeError, ValueError):
        return None
