"""Which variable of an FMU is which canonical signal: by name and unit, or as a mapping says."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches

from eps_hil.bus import units
from eps_hil.check.guess import LEAST, Candidate, guess
from eps_hil.errors import InputError
from eps_hil.fmu.described import Described, FmuVariable
from eps_hil.fmu.variables import RATES
from eps_hil.recordings.foreign import Column, Columns
from eps_hil.signals import CANONICAL, PUBLISHED

DRIVING = ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")
_WORD = {"torque": "torque", "angular speed": "speed", "angle": "angle", "force": "force",
         "length": "position", "temperature": "temperature"}  # fmt: skip
_UNIT = {"torque": "Nm", "angular speed": "rad/s", "angle": "rad", "force": "N", "length": "m",
         "speed": "m/s", "acceleration": "m/s^2", "temperature": "degC"}  # fmt: skip
_ALONE = {"torque": "motor_torque_nm", "force": "rack_force_n",
          "angular speed": "motor_speed_rad_s", "angle": "motor_angle_rad",
          "length": "rack_position_m"}  # fmt: skip
"""What a variable is whose unit no other variable has, and whose name says nothing."""


@dataclass(frozen=True, slots=True)
class Link:
    """One signal and its variable: canonical = ``scale`` · variable + ``offset``; why."""

    canonical: str
    variable: FmuVariable
    scale: float
    offset: float
    why: str

    def said(self) -> str:
        """For a person."""
        unit = self.variable.unit or "no unit"
        sign = "" if self.scale > 0 else ", sign turned"
        return f"{self.canonical} is {self.variable.name} ({unit}{sign}; {self.why})"


@dataclass(frozen=True, slots=True)
class Mapped:
    """What drives an FMU, what is compared, where it starts; ``open``: inputs left as they are,
    switches among them."""

    inputs: Mapping[str, Link]
    outputs: Mapping[str, Link]
    start: Mapping[str, Link]
    open: tuple[str, ...]


def map_fmu(fmu: Described, columns: Columns | None = None) -> Mapped:
    """The mapping; ``columns`` (a mapping's ``signals``) goes before what is guessed.

    Its scales count from the FMU's own unit, as they do from a column's; where it gives none, or
    turns the sign alone, the declared unit says how to come to ours.
    :class:`InputError` for a variable that is not there, for a unit of something else, and where
    neither speed nor angle comes out.
    """
    inputs, outputs = fmu.of("input"), fmu.of("output", "local")
    said = {} if columns is None else dict(columns.signals)
    given = {name: _given(fmu, name, one, {**inputs, **outputs}) for name, one in said.items()}
    taken = {one.variable.name for one in given.values()}
    driving = {n: one for n, one in given.items() if one.variable.name in inputs}
    driving |= _guessed(inputs, DRIVING, driving, taken)
    coming = {n: one for n, one in given.items() if n not in driving}
    rest = [n for n in CANONICAL if n not in (*PUBLISHED, *driving)]
    coming |= _guessed(fmu.of("output"), rest, coming, taken)
    if not {"motor_speed_rad_s", "motor_angle_rad"} & coming.keys():
        there = ", ".join(list(fmu.of("output"))[:8]) or "none"
        raise InputError(
            fmu.path, "", "no output is known as rotor speed or angle", f"name it in "
            f"--simulation-signals (motor_speed_rad_s: {{column: …}}); its outputs are: {there}",
        )  # fmt: skip
    if "motor_torque_nm" not in driving:
        there = ", ".join(list(inputs)[:8]) or "none"
        raise InputError(
            fmu.path, "", "no input is known as the motor torque", f"name it in "
            f"--simulation-signals (motor_torque_nm: {{column: …}}); its inputs are: {there}",
        )  # fmt: skip
    starts = {}
    for name in ("motor_speed_rad_s", "motor_angle_rad"):
        one = fmu.variables.get(f"start_{name}")
        if one is not None and one.causality == "parameter":
            starts[name] = _link(fmu, name, one, Column(one.name), "by its name")
    used = {one.variable.name for one in driving.values()}
    used |= {one.name for one in RATES}
    left = [n for n in inputs if n not in used]
    left += [n for n, one in fmu.others.items() if one.causality == "input"]
    return Mapped(driving, coming, starts, tuple(left))


def _given(fmu: Described, name: str, column: Column, there: Mapping[str, FmuVariable]) -> Link:
    if column.sum or column.torque_constant_nm_per_a or column.counts_per_turn:
        raise InputError(fmu.path, name, "an FMU's signal is one variable, with scale and offset",
                         "give it a column")  # fmt: skip
    return _link(fmu, name, variable(fmu, column.column, there, "no input or output"), column,
                 "as the mapping says")  # fmt: skip


def variable(fmu: Described, name: str, there: Mapping[str, FmuVariable], what: str) -> FmuVariable:
    """The variable of that name; :class:`InputError` with the nearest one where there is none."""
    if name not in there:
        near = get_close_matches(name, there, n=1, cutoff=0.4)
        remedy = (
            f"did you mean '{near[0]}'?" if near else f"there are: {', '.join(list(there)[:8])}"
        )
        raise InputError(fmu.path, f"variable '{name}'", f"is {what} of it", remedy)
    return there[name]


def _link(fmu: Described, name: str, one: FmuVariable, column: Column, why: str) -> Link:
    wanted = units.quantity(CANONICAL[name].unit)
    if one.quantity is not None and one.quantity != wanted:
        raise InputError(fmu.path, f"variable '{one.name}'",
                         f"is in {one.unit}, {name} ({CANONICAL[name].unit}) was expected",
                         "choose another one")  # fmt: skip
    if abs(column.scale) != 1.0:
        return Link(name, one, column.scale, column.offset, f"{why}, times {column.scale:g}")
    factor, shift = one.to_si or (1.0, 0.0)
    if column.offset and (factor, shift) != (1.0, 0.0):
        raise InputError(fmu.path, name, f"has an offset, and '{one.name}' is in {one.unit}",
                         "give its scale, too")  # fmt: skip
    return Link(name, one, column.scale * factor, column.scale * shift + column.offset, why)


def _guessed(
    there: Mapping[str, FmuVariable], wanted: Iterable[str], known: Mapping[str, Link],
    taken: Iterable[str],
) -> dict[str, Link]:  # fmt: skip
    wanted = [name for name in wanted if name not in known]
    free = {
        name: one
        for name, one in there.items()
        if name not in taken and (one.quantity is None or one.quantity in _UNIT)
    }
    candidates, originals = [], {}
    for name, one in free.items():
        word = _WORD.get(one.quantity or "", "")
        told = name if name in CANONICAL else f"{name.replace('.', '_')}_{word}".strip("_")
        originals[told] = one
        unit = _UNIT.get(one.quantity or "", one.unit) if one.quantity else one.unit
        candidates.append(Candidate(told, unit or None))
    found: dict[str, Link] = {}
    for name, offer in guess(candidates).items():
        if name in wanted and offer.sure >= LEAST:
            found[name] = _guess(name, originals[offer.of.name], "by name and unit")
    for quantity, name in _ALONE.items():
        alike = [one for one in free.values() if one.quantity == quantity]
        if name in wanted and name not in found and len(alike) == 1:
            used = {link.variable.name for link in found.values()}
            if alike[0].name not in used:
                found[name] = _guess(name, alike[0], "the only one of this unit")
    return found


def _guess(name: str, one: FmuVariable, why: str) -> Link:
    factor, shift = one.to_si or (1.0, 0.0)
    return Link(name, one, factor, shift, why if one.to_si else f"{why}, unit unknown")
