"""Reported samples put to one physical instant, on line (DESIGN decision 2).

The newest instant of which everything is known lies the largest delay back; there each signal is
read at (instant + its delay), by the estimator's own ring and interpolation.
"""

import math

import numpy as np
import numpy.typing as npt

from eps_hil.adaptation.gates import InjectionInputs
from eps_hil.compiled import kernel
from eps_hil.estimation.alignment import RING, push_sample, read_at
from eps_hil.physics.model import Model

_STALE_NS = 20_000_000
_NAMES = (
    "motor_torque_nm",
    "motor_speed_rad_s",
    "torque_sensor_nm",
    "motor_angle_rad",
    "rack_force_n",
)


Int64 = npt.NDArray[np.int64]
Float64 = npt.NDArray[np.float64]


@kernel
def _push_all(stamps: Int64, values: Float64, count: Int64, t: int, row: Float64) -> None:
    for i in range(len(row)):
        push_sample(stamps, values, count, i, t, row[i])


@kernel
def _read_all(
    stamps: Int64, values: Float64, count: Int64, at: int, delay: Int64, row: Float64
) -> None:
    for i in range(len(row)):
        value, lost = read_at(stamps, values, count, i, at + delay[i], _STALE_NS, 1)
        row[i] = value if lost == 0 else np.nan


class Aligned:
    """:meth:`push` once per sample; then :meth:`read` gives the signals of one earlier instant."""

    def __init__(self, model: Model) -> None:
        n = len(_NAMES)
        self._stamps, self._values = np.zeros((n, RING), np.int64), np.zeros((n, RING))
        self._count, self._row = np.zeros(n, np.int64), np.zeros(n)
        delay_ns = [round(model.delays_s.of(name) * 1e9) for name in _NAMES]
        self._sensor_came = False
        self._delay_ns, self._late_ns = np.array(delay_ns, np.int64), max(delay_ns)

    def push(self, t_ns: int, inputs: InjectionInputs) -> None:
        """The newest values by ``t_ns``; stamps that do not go forward are ignored."""
        self._row[0], self._row[1] = inputs.motor_torque_nm, inputs.motor_speed_rad_s
        self._row[2], self._row[3] = inputs.torque_sensor_nm, inputs.motor_angle_rad
        self._row[4] = inputs.rack_force_n
        _push_all(self._stamps, self._values, self._count, t_ns, self._row)

    def clear(self) -> None:
        """Forget all samples."""
        self._count[:] = 0

    def read(self, t_ns: int) -> tuple[int, InjectionInputs]:
        """(physical instant, signals of it); NaN where a signal is missing, lost or broken.

        A torsion-bar torque that never came is absent, and zero; later it is lost (CONTRACT 2).
        """
        at = t_ns - self._late_ns
        _read_all(self._stamps, self._values, self._count, at, self._delay_ns, self._row)
        torque, speed, sensor, angle, force = self._row.tolist()
        self._sensor_came |= math.isfinite(sensor)
        if not self._sensor_came:
            sensor = 0.0
        return at, InjectionInputs(torque, speed, sensor, angle, rack_force_n=force)
