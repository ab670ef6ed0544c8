"""The samples of one ramp and slide, kept as they came and put to their physical instants."""

import math
from collections import deque
from collections.abc import Generator

import numpy as np

from eps_hil.adaptation.gates import InjectionInputs
from eps_hil.adaptation.slide import Floats, Slide, SlideLevel, slide_level
from eps_hil.physics.model import Model

_STEP_S = 1e-3
_BEFORE = 200
_LONGEST = 60_000
"""Samples of one ramp that are kept: a minute. A longer one gives no level."""
_SMOOTH = 11
"""Samples of the moving mean over the measured angle."""
_OFFSET_S = 0.05
"""Rest before the ramp from which position and bristle torque at the start are taken."""


class SlideRecord:
    """Fed with every sample; :meth:`begin` marks the start of a ramp, :meth:`level` reads it off.

    Torques at the rotor; ``torque_now_nm`` (mean of 5 samples) and ``travel_now_rad`` are as
    reported, along the direction of the ramp.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self._direction = 1
        self._stamps = np.zeros(_LONGEST, np.int64)
        self._table = np.zeros((_LONGEST, len(InjectionInputs._fields)))
        self._n = 0
        self._torques: deque[float] = deque(maxlen=5)
        self._start_ns = 0
        self._integrated_rad = self._start_rad = self._angle_rad = 0.0
        self.running = False
        self.torque_now_nm = self.travel_now_rad = 0.0

    def add(self, t_ns: int, inputs: InjectionInputs) -> None:
        """One sample with its stamp."""
        if self._n:
            dt_s = (t_ns - int(self._stamps[self._n - 1])) * 1e-9
            self._integrated_rad += inputs.motor_speed_rad_s * dt_s
        if self._n == _LONGEST or (not self.running and self._n >= 2 * _BEFORE):
            self._keep_newest()
        self._stamps[self._n] = t_ns
        self._table[self._n] = inputs
        self._n += 1
        sensor = inputs.torque_sensor_nm if math.isfinite(inputs.torque_sensor_nm) else 0.0
        torque = inputs.motor_torque_nm + self._model.sensor_to_rotor * sensor
        self._torques.append(torque)
        self.torque_now_nm = self._direction * sum(self._torques) / len(self._torques)
        angle = inputs.motor_angle_rad
        self._angle_rad = angle if math.isfinite(angle) else self._integrated_rad
        self.travel_now_rad = self._direction * (self._angle_rad - self._start_rad)

    def begin(self, direction: int) -> None:
        """The ramp starts with the next sample."""
        self._direction = direction
        if self._n == 0:
            return
        self._keep_newest()
        self._start_ns = int(self._stamps[self._n - 1])
        self._start_rad = self._angle_rad
        self.running = True

    def end(self) -> None:
        """The ramp is over and of no use."""
        self.running = False

    def _keep_newest(self) -> None:
        kept = min(self._n, _BEFORE)
        part = slice(self._n - kept, self._n)
        self._stamps[:kept], self._table[:kept] = self._stamps[part], self._table[part]
        self._n = kept

    def level(self, guess_nm: float, positive: bool) -> Generator[None, None, SlideLevel | None]:
        """k0 of what was recorded since :meth:`begin`, a piece of the sum at each ``next``.

        The record is read with the first, and ends.
        """
        whole = self._n > 0 and int(self._stamps[0]) < self._start_ns
        self.end()
        slide = self._slide() if whole else None  # else longer than can be kept
        if slide is None:
            return None
        yield
        return (yield from slide_level(slide, self._model, positive=positive, guess_nm=guess_nm))

    def _slide(self) -> Slide | None:
        """None where the ramp ended before any of its samples had come, late as they are."""
        time_s = (self._stamps[: self._n] - self._start_ns) * 1e-9
        columns = dict(zip(InjectionInputs._fields, self._table[: self._n].T, strict=True))
        delays = self._model.delays_s
        late = max(delays.of(name) for name in InjectionInputs._fields)
        at = np.arange(-_OFFSET_S, time_s[-1] - late, _STEP_S)
        if not np.any(at >= 0.0):
            return None

        def read(name: str) -> Floats:
            values = columns[name]
            good = np.isfinite(values)
            if not good.any():
                return np.zeros(len(at))
            return np.interp(at + delays.of(name), time_s[good], values[good])

        sign = float(self._direction)
        torque = read("motor_torque_nm") + self._model.sensor_to_rotor * read("torque_sensor_nm")
        speed, force = read("motor_speed_rad_s"), read("rack_force_n")
        if np.isfinite(columns["motor_angle_rad"]).all():
            angle = _moving_mean(read("motor_angle_rad"))
        else:
            angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) * _STEP_S
        rest = at < 0.0
        drive = torque - force / self._model.rack_to_rotor_ratio_rad_per_m
        return Slide(
            step_s=_STEP_S,
            torque_nm=sign * torque[~rest],
            speed_rad_s=sign * speed[~rest],
            travel_rad=sign * (angle - float(np.mean(angle[rest])))[~rest],
            force_n=sign * force[~rest],
            preload_nm=sign * float(np.mean(drive[rest])),
        )


def _moving_mean(values: Floats) -> Floats:
    padded = np.pad(values, _SMOOTH // 2, mode="edge")
    return np.convolve(padded, np.ones(_SMOOTH) / _SMOOTH, mode="valid")
