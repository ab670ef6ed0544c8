"""Recordings through somebody's FMU, as the traces that a diagnosis compares them with."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eps_hil import json_text, yaml_file
from eps_hil.errors import InputError
from eps_hil.fmu.drive import MOTION, Signals, Simulator, opened
from eps_hil.fmu.mapping import variable
from eps_hil.physics.model import Model
from eps_hil.recordings.coverage import invented
from eps_hil.recordings.files import read_bytes
from eps_hil.recordings.foreign import Columns

_NEEDED = "motor_torque_nm"


def traces_of(
    path: Path,
    recordings: Mapping[str, Signals],
    model: Model,
    columns: Columns | None = None,
    values: Mapping[str, float] | None = None,
) -> tuple[dict[str, Signals], list[str]]:
    """The FMU's answer to each recording, and how its variables were understood."""
    with opened(path, columns) as simulator:
        known = checked(simulator, values or {})
        notes = simulator.notes()
        notes += unmet(simulator, recordings)
        short = len({Path(name).name for name in recordings}) == len(recordings)
        traces: dict[str, Signals] = {
            f"{path.name} on {Path(name).name if short else name}": simulator.trace(
                series, model, known
            )
            for name, series in recordings.items()
        }
    return traces, notes


def unmet(simulator: Simulator, recordings: Mapping[str, Signals]) -> list[str]:
    """Inputs that a recording does not hold, or not all the time, and gaps of its motion.

    :class:`InputError` for one without a torque or motion, or where they never come together.
    """
    notes = []
    for name, series in recordings.items():
        there = f"it holds {', '.join(sorted(series))}"
        motion = [one for one in MOTION if one in series]
        if _NEEDED not in series:
            raise InputError(name, "", f"needs {_NEEDED}, which drives the FMU", there)
        if not motion:
            wanted = " or ".join(MOTION)
            raise InputError(name, "", f"needs {wanted}, at which the FMU is kept", there)
        both = [series[one] for one in (_NEEDED, *motion)]
        if max(one.t_ns[0] for one in both) >= min(one.t_ns[-1] for one in both):
            problem = f"{_NEEDED} and {' and '.join(motion)} have no time in common"
            raise InputError(name, "", problem, "record them together")
        notes += [
            f"{name}: no {one}: {link.variable.name} is driven with zero"
            for one, link in simulator.mapped.inputs.items()
            if one not in series
        ]
        found = invented(series, [*simulator.mapped.inputs, *motion], _NEEDED)
        notes += [f"{name}: {note}" for note in found]
    return notes


def checked(simulator: Simulator, values: Mapping[str, float]) -> dict[str, float]:
    """Values of parameters, and of inputs that stay at their start; the FMU has each of them."""
    fmu, left = simulator.fmu, simulator.mapped.open
    there = {
        name: one
        for name, one in {**fmu.variables, **fmu.others}.items()
        if name in left or one.causality == "parameter"
    }
    for name, value in values.items():
        one = variable(fmu, name, there, "no parameter, and no input without a signal,")
        wanted = ""
        if one.kind == "Boolean":
            wanted = "" if value in (0, 1) else "true or false"
        elif isinstance(value, bool):
            wanted = "a number"
        elif one.whole and not float(value).is_integer():
            wanted = "a whole number"
        if wanted:
            raise InputError(fmu.path, f"variable '{name}'", f"is {value!r}, {wanted} was expected")
    return dict(values)


def read_values(path: Path) -> dict[str, float]:
    """Parameters and switches from a YAML file ``name: value``, or the JSON of ``identify``."""
    content: Any
    if path.suffix == ".json":
        try:
            content = json_text.parse(read_bytes(path), pairs=_each_once)
        except ValueError as error:
            raise InputError(path, "", str(error), "write it with identify --json") from None
    else:
        content = yaml_file.read(path)
    if isinstance(content, dict) and isinstance(content.get("parameters"), dict):
        content = {name: one.get("value") if isinstance(one, dict) else one
                   for name, one in content["parameters"].items()}  # fmt: skip
    if not isinstance(content, dict) or not content:
        raise InputError(path, "", "holds no parameters", "name: value, a line each")
    for name, value in content.items():
        if not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(path, str(name), f"is {value!r}, a number was expected")
    return {str(name): value if isinstance(value, bool) else float(value)
            for name, value in content.items()}  # fmt: skip


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; of a key that stands twice, JSON would take the last one."""
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"'{next(name for name in names if names.count(name) > 1)}' stands twice")
    return found
