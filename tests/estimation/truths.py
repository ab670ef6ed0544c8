"""Recordings of a rig of other code, as signals, and estimates judged by what was true there."""

from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.estimation.stream import Trace
from eps_hil.series import Series

BASE = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s")
ANGLE = (*BASE, "motor_angle_rad")
Floats = npt.NDArray[np.float64]


def series_of(
    truth: Any, names: tuple[str, ...] = BASE, rows: int | None = None
) -> dict[str, Series]:
    t_ns = np.round(truth.columns["time_s"] * 1e9).astype(np.int64)[:rows]
    return {n: Series(t_ns, np.array(truth.columns[n][:rows], dtype=np.float64)) for n in names}


def errors(truth: Any, trace: Trace) -> tuple[Floats, Floats]:
    """Error (N) of the valid rows after the first half second, and true speed (rad/s) there."""
    keep = trace.valid & (trace.t_ns > 500_000_000) & (trace.t_ns < truth.time_s[-1] * 1e9 - 3e8)
    time_s = trace.t_ns[keep] * 1e-9
    error = trace.rack_force_n[keep] - np.interp(time_s, truth.time_s, truth.rack_force_n)
    return error, np.interp(time_s, truth.time_s, truth.speed_rad_s)


def rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
