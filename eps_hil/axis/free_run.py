"""The benchmark's own question: force in, position out, over a whole record; nothing fed back.

The first 20 samples may be looked at for the state to begin from; they do not count.
"""

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.axis.emps import ARM_M, AxisRecord
from eps_hil.diagnosis.data.prepare import EDGE_S, SMOOTH_HZ, STEP_S, prepare
from eps_hil.identification.butterworth import low_pass
from eps_hil.physics.balance import residual_nm
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import simulate
from eps_hil.recordings.files import replacing

Floats = npt.NDArray[np.float64]

BEGIN = 20
"""Samples that show the first state, and are not judged."""
FILE = "free_run.csv"
MOVES_M_S = 0.005
"""Speed from which friction has a direction."""


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


def replayed_rmse_mm(record: AxisRecord, other: AxisRecord) -> float:
    """The error of an answer that is ``other``'s recorded position and looks at no force at all.

    Where both were driven along one reference, it says what the score of a free run is worth.
    """
    n = min(len(record.position_m), len(other.position_m))
    apart = other.position_m[:n] + other.middle_m - record.position_m[:n] - record.middle_m
    return 1e3 * float(np.sqrt(np.mean(apart[BEGIN:] ** 2)))


def friction_apart_n(record: AxisRecord, model: Model) -> tuple[float, float]:
    """How much more friction (N) ``record`` has than ``model``, forward and backward.

    Means over what moves, with all of the force at the input known: what lasts, a free run adds up.
    """
    (whole,) = friction_course_n(record, model, 1)
    return whole


def friction_course_n(
    record: AxisRecord, model: Model, parts: int = 4
) -> list[tuple[float, float]]:
    """:func:`friction_apart_n` of each of so many equal parts of the record, in order."""
    known = replace(record, force_n=record.force_n - record.hidden_force_n)
    motion = prepare(known.name, known.series()).motion(model)
    short = low_pass(residual_nm(model, motion)[0] / ARM_M, SMOOTH_HZ)
    speed = low_pass(np.gradient(record.position_m, STEP_S), SMOOTH_HZ)
    inside = slice(round(EDGE_S / STEP_S), -round(EDGE_S / STEP_S))
    found = []
    for some, rate in zip(
        np.array_split(short[inside], parts), np.array_split(speed[inside], parts), strict=True
    ):
        ways = (rate > MOVES_M_S, rate < -MOVES_M_S)
        forth, back = (float(np.mean(some[way])) if way.any() else 0.0 for way in ways)
        found.append((forth, -back))
    return found


def with_more_friction(model: Model, forward_n: float, backward_n: float) -> Model:
    """``model`` with so much more Coulomb friction: what a record's own friction is worth."""
    friction = model.friction
    moved = replace(
        friction,
        offset_pos_nm=friction.offset_pos_nm + forward_n * ARM_M,
        offset_neg_nm=friction.offset_neg_nm + backward_n * ARM_M,
    )
    return replace(model, friction=moved)


def write(folder: Path, record: AxisRecord, run: FreeRun) -> Path:
    """``free_run.csv`` (time_s, position_m as the record counts it), for anybody to score."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / FILE
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time_s", "position_m"])
        for k, place in enumerate((run.position_m + record.middle_m).tolist()):
            rows.writerow([f"{k * STEP_S:.3f}", f"{place:.9f}"])
    return path
