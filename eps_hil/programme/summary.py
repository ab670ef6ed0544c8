"""What a finished programme comes to: a table of cells, eq. 3 from them, and the whole model.

Eq. 3 from the cells' means is what the paper did. The identification from the logs takes every
sample, reversals and ways to the next cell included, and so finds inertia, delays and bristle too.
"""

import csv
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from eps_hil.bus.config import BusSetup
from eps_hil.errors import InputError
from eps_hil.identification.constant_speed import Cell, enough, fitted
from eps_hil.identification.identify import identify
from eps_hil.identification.result import Identification
from eps_hil.identification.write_model import model_file
from eps_hil.physics.effects.added import added, in_use
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Friction, Model
from eps_hil.programme.plan import Plan
from eps_hil.programme.recordings import joined
from eps_hil.programme.run import Summary
from eps_hil.recordings.files import replacing

SCHEMA = "eps-hil/programme-result/1"
_COLUMNS = (
    "number", "repetition", "speed_rad_s", "preload_n", "mean_speed_rad_s", "mean_load_n",
    "friction_nm", "samples", "lost_frames", "attempt", "problems",
)  # fmt: skip
_LEAST = 2


@dataclass(frozen=True, slots=True)
class Identified:
    """Friction of eq. 3 with the half width of each 95 % interval; or why there is none."""

    friction: Friction | None
    half_widths: dict[str, float]
    problem: str = ""


@dataclass(frozen=True, slots=True)
class Whole:
    """The identification from the logs and its model file's text; or why there is none."""

    found: Identification | None
    text: str = ""
    problem: str = ""


def identify_logs(
    summary: Summary,
    setup: BusSetup,
    model: Model,
    folder: Path,
    on_progress: Callable[[float], None] | None = None,
) -> Whole:
    """Everything that the logs of the accepted cells tell; a refusal becomes a ``problem``."""
    logs = [folder / f"{one.cell.name}.log" for one in summary.accepted]
    try:
        recordings = joined(logs, setup)
        found = identify(recordings, model, on_progress)
    except InputError as error:
        return Whole(None, problem=str(error))
    return Whole(found, model_file(found, str(setup.model), list(recordings)))


def identified(summary: Summary, model: Model) -> Identified:
    """Eq. 3 from the accepted cells; it needs two speeds and two loads in each direction."""
    cells = [one.measured for one in summary.accepted]
    for sign, word in ((1.0, "positive"), (-1.0, "negative")):
        own = [cell for cell in cells if cell.set_speed_rad_s * sign > 0]
        speeds = len({cell.set_speed_rad_s for cell in own})
        loads = len({abs(cell.set_load_n) for cell in own})
        if speeds < _LEAST or loads < _LEAST:
            problem = (
                f"{word} direction: {speeds} speeds and {loads} loads are good, "
                f"eq. 3 needs {_LEAST} of each"
            )
            return Identified(None, {}, problem)
        if not enough([cell for cell in cells if cell.speed_rad_s * sign > 0]):
            problem = (
                f"{word} direction: {len(own)} cells are good; eq. 3 needs four, with speeds and "
                "loads that do not change together"
            )
            return Identified(None, {}, problem)
    friction, widths = fitted(cells, model.friction)
    return Identified(friction, widths)


def counted_twice(model: Model) -> str:
    """Why levels of the cells cannot stand in this model's file; empty if they can.

    The friction of a cell is all that there is, what the file's effects add to eq. 3 among it.
    """
    use = in_use(added(with_model_effects(model)))
    if not (use.level or use.torque or use.load):
        return ""
    names = ", ".join(str(entry["effect"]) for entry in model.effects)
    return f"the cells' friction holds what the effects of the model file ({names}) make of it, too"


def table_file(summary: Summary, path: Path) -> None:
    """Every cell as one line of CSV."""
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, _COLUMNS)
        writer.writeheader()
        writer.writerows(_rows(summary))


def content(
    plan: Plan, summary: Summary, found: Identified, whole: Whole | None = None
) -> dict[str, Any]:
    """JSON-ready."""
    return {
        "schema": SCHEMA,
        "programme": plan.content(),
        "cells": _rows(summary),
        "friction": asdict(found.friction) if found.friction else None,
        "half_width95": found.half_widths,
        "problem": found.problem,
        "identification": whole.found.content() if whole and whole.found else None,
        "identification_problem": whole.problem if whole else "",
    }


def _rows(summary: Summary) -> list[dict[str, Any]]:
    return [
        {
            "number": one.cell.number,
            "repetition": one.cell.repetition,
            "speed_rad_s": one.cell.speed_rad_s,
            "preload_n": one.cell.preload_n,
            **_measured(one.measured),
            "samples": one.samples,
            "lost_frames": one.lost_frames,
            "attempt": one.attempt,
            "problems": "; ".join(one.problems),
        }
        for one in summary.results
    ]


def _measured(cell: Cell) -> dict[str, float]:
    return {
        "mean_speed_rad_s": cell.speed_rad_s,
        "mean_load_n": cell.load_n,
        "friction_nm": cell.friction_nm,
    }
