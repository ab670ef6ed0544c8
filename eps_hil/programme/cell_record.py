"""What one cell gave: its samples while they come in, and its file once it is finished.

A cell's ``.json`` is written last and whole; a cell without it has not been run. So a programme
that was killed keeps every finished cell and repeats the one that was running.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil import json_text
from eps_hil.bus.message_decoder import Sample
from eps_hil.errors import InputError
from eps_hil.identification.constant_speed import Cell, reading
from eps_hil.physics.model import Model
from eps_hil.programme.plan import PlannedCell
from eps_hil.recordings.files import replacing

SCHEMA = "eps-hil/programme-cell/1"
MEASURED = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "rack_force_n")
_LEAST_SAMPLES = 20
_SPEED_SHARE = 0.05
_FORCE_SHARE, _FORCE_LEAST_N = 0.02, 20.0


@dataclass(frozen=True, slots=True)
class CellResult:
    """A finished cell; ``problems`` is empty where it may be used."""

    cell: PlannedCell
    measured: Cell
    samples: int
    lost_frames: int
    attempt: int
    problems: tuple[str, ...]

    @property
    def accepted(self) -> bool:
        """Whether the pass is good enough to identify from."""
        return not self.problems


@dataclass(slots=True)
class Collector:
    """Samples of the stretch that counts, put back to their physical instants."""

    model: Model
    stamps: dict[str, list[int]] = field(default_factory=dict)
    values: dict[str, list[float]] = field(default_factory=dict)

    def take(self, samples: list[Sample]) -> None:
        """Keep what the reading needs; samples known to be bad are left out."""
        for name, t_ns, value in samples:
            if name in MEASURED and math.isfinite(value):
                late = round(self.model.delays_s.of(name) * 1e9)
                self.stamps.setdefault(name, []).append(t_ns - late)
                self.values.setdefault(name, []).append(value)

    def result(self, cell: PlannedCell, lost_frames: int, attempt: int) -> CellResult:
        """Means over the stretch in which every signal is there, and what speaks against them."""
        missing = [name for name in MEASURED if len(self.values.get(name, ())) < _LEAST_SAMPLES]
        if missing:
            problem = f"too few samples of {', '.join(missing)}"
            return self._nothing(cell, lost_frames, attempt, problem)
        first = max(self.stamps[name][0] for name in MEASURED)
        last = min(self.stamps[name][-1] for name in MEASURED)
        samples = {}
        for name in MEASURED:
            stamps = np.array(self.stamps[name])
            keep = (stamps >= first) & (stamps <= last)
            samples[name] = np.array(self.values[name])[keep]
        seconds = (last - first) * 1e-9
        count = min(len(value) for value in samples.values())
        if count < _LEAST_SAMPLES:  # a clock that was set back, say
            return self._nothing(cell, lost_frames, attempt, "the signals share too few samples")
        found = reading(cell.speed_rad_s, cell.preload_n, samples, seconds, self.model)
        return CellResult(cell, found, count, lost_frames, attempt, _problems(found, lost_frames))

    @staticmethod
    def _nothing(cell: PlannedCell, lost_frames: int, attempt: int, problem: str) -> CellResult:
        nothing = Cell(cell.speed_rad_s, cell.preload_n, *(float("nan"),) * 3)
        return CellResult(cell, nothing, 0, lost_frames, attempt, (problem,))


def _problems(found: Cell, lost_frames: int) -> tuple[str, ...]:
    said = []
    away = abs(found.speed_rad_s - found.set_speed_rad_s)
    if away > _SPEED_SHARE * abs(found.set_speed_rad_s):
        said.append(f"speed {found.speed_rad_s:.3g} instead of {found.set_speed_rad_s:g} rad/s")
    if abs(found.load_n - found.set_load_n) > max(
        _FORCE_LEAST_N, _FORCE_SHARE * abs(found.set_load_n)
    ):
        said.append(f"force {found.load_n:.4g} instead of {found.set_load_n:g} N")
    if lost_frames:
        said.append(f"{lost_frames} frames lost")
    if found.friction_nm * found.set_speed_rad_s <= 0.0:
        said.append("friction does not oppose the motion: a sign or a channel is wrong")
    return tuple(said)


def write(result: CellResult, folder: Path) -> None:
    """The cell's ``.json``, whole or not at all."""
    cell, found = result.cell, result.measured
    content = {
        "schema": SCHEMA,
        "number": cell.number,
        "speed_rad_s": cell.speed_rad_s,
        "preload_n": cell.preload_n,
        "repetition": cell.repetition,
        "attempt": result.attempt,
        "problems": list(result.problems),
        "samples": result.samples,
        "lost_frames": result.lost_frames,
        "mean_speed_rad_s": _number(found.speed_rad_s),
        "mean_load_n": _number(found.load_n),
        "friction_nm": _number(found.friction_nm),
    }
    with replacing(folder / f"{cell.name}.json") as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def read(cell: PlannedCell, folder: Path) -> CellResult | None:
    """A finished cell, None where it is yet to be run; :class:`InputError` for another's file."""
    path = folder / f"{cell.name}.json"
    if not path.exists():
        return None
    try:
        content: Mapping[str, Any] = json_text.parse(path.read_text(encoding="utf-8"))
        told = PlannedCell(
            *(content[key] for key in ("number", "speed_rad_s", "preload_n", "repetition"))
        )
        keys = ("mean_speed_rad_s", "mean_load_n", "friction_nm")
        numbers = (float("nan") if content[key] is None else content[key] for key in keys)
        found = Cell(cell.speed_rad_s, cell.preload_n, *numbers)
        counts = content["samples"], content["lost_frames"], content["attempt"]
        result = CellResult(told, found, *counts, tuple(content["problems"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        problem = f"is no cell of a programme: {error}"
        raise InputError(path, "", problem, "delete it to run that cell again") from None
    if told != cell:
        problem = "belongs to another cell than the programme says"
        raise InputError(path, "", problem, "use another folder, or delete it")
    return result


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
