"""Reported samples put to one physical instant, on line (DESIGN decision 2).

The newest instant of which everything is known lies the largest delay back; there each signal is
read at (instant + its delay), by the estimator's own ring and interpolation.
"""

import numpy as np

from eps_hil.adaptation.gates import InjectionInputs
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


class Aligned:
    """:meth:`push` once per sample; then :meth:`read` gives the signals of one earlier instant."""

    def __init__(self, model: Model) -> None:
        n = len(_NAMES)
        self._stamps, self._values = np.zeros((n, RING), np.int64), np.zeros((n, RING))
        self._count = np.zeros(n, np.int64)
        self._delay_ns = [round(model.delays_s.of(name) * 1e9) for name in _NAMES]
        self._late_ns = max(self._delay_ns)

    def push(self, t_ns: int, inputs: InjectionInputs) -> None:
        """The newest values by ``t_ns``; stamps that do not go forward are ignored."""
        for i, name in enumerate(_NAMES):
            push_sample(self._stamps, self._values, self._count, i, t_ns, getattr(inputs, name))

    def clear(self) -> None:
        """Forget all samples."""
        self._count[:] = 0

    def read(self, t_ns: int) -> tuple[int, InjectionInputs]:
        """(physical instant, signals of it); NaN where a signal is missing, lost or broken."""
        at = t_ns - self._late_ns
        found = {}
        for i, name in enumerate(_NAMES):
            value, lost = read_at(
                self._stamps, self._values, self._count, i, at + self._delay_ns[i], _STALE_NS, 1
            )
            found[name] = float("nan") if lost else value
        return at, InjectionInputs(**found)
