"""The benchmark's own question: force in, position out, over a whole record; nothing fed back.

The first 20 samples may be looked at for the state to begin from; they do not count.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.axis.emps import ARM_M, AxisRecord
from eps_hil.diagnosis.data.prepare import STEP_S
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import simulate

Floats = npt.NDArray[np.float64]

BEGIN = 20
"""Samples that show the first state, and are not judged."""
FILE = "free_run.csv"


@dataclass(frozen=True)
class FreeRun:
    """The position (m, (n,), from the middle of the travel) that a model makes of a record."""

    position_m: Floats
    rmse_mm: float


def free_run(record: AxisRecord, model: Model) -> FreeRun:
    """Simulate ``record`` from its first state, driven by all of the force at its input."""
    model = with_model_effects(model)
    n = len(record.position_m)
    time = np.asarray(np.arange(n) * STEP_S, dtype=np.float64)
    late = -model.delays_s.motor_torque  # of the motor's report; below zero where it acts later
    force = np.interp(time - late, time, record.force_n - record.hidden_force_n)
    first = slice(0, BEGIN + 1)
    speed = np.polyfit(time[first], record.position_m[first], 2)[1]
    nothing = np.zeros(n)
    run = simulate(
        model,
        time,
        force * ARM_M,
        nothing,
        nothing,
        speed_rad_s=float(speed / ARM_M),
        angle_rad=float(record.position_m[0] / ARM_M),
    )
    position = run.angle_rad * ARM_M
    error = (position - record.position_m)[BEGIN:]
    return FreeRun(position, 1e3 * float(np.sqrt(np.mean(error**2))))


def write(folder: Path, record: AxisRecord, run: FreeRun) -> Path:
    """``free_run.csv`` (time_s, position_m as the record counts it), for anybody to score."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / FILE
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time_s", "position_m"])
        for k, place in enumerate((run.position_m + record.middle_m).tolist()):
            rows.writerow([f"{k * STEP_S:.3f}", f"{place:.9f}"])
    return path
