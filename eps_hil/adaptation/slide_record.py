"""The samples of one ramp and slide, kept as they came and put to their physical instants."""

import math
from collections import deque

import numpy as np

from eps_hil.adaptation.gates import InjectionInputs
from eps_hil.adaptation.slide import Floats, Slide, SlideLevel, slide_level
from eps_hil.physics.model import Model

_STEP_S = 1e-3
_BEFORE = 200
_LONGEST = 60_000
"""Samples of one ramp that are kept; a longer one loses its beginning."""
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
        self._rows: deque[tuple[int, InjectionInputs]] = deque(maxlen=_BEFORE)
        self._torques: deque[float] = deque(maxlen=5)
        self._start_ns = 0
        self._integrated_rad = self._start_rad = 0.0
        self.running = False
        self.torque_now_nm = self.travel_now_rad = 0.0

    def add(self, t_ns: int, inputs: InjectionInputs) -> None:
        """One sample with its stamp."""
        if self._rows:
            dt_s = (t_ns - self._rows[-1][0]) * 1e-9
            self._integrated_rad += inputs.motor_speed_rad_s * dt_s
        self._rows.append((t_ns, inputs))
        sensor = inputs.torque_sensor_nm if math.isfinite(inputs.torque_sensor_nm) else 0.0
        torque = inputs.motor_torque_nm + self._model.sensor_to_rotor * sensor
        self._torques.append(torque)
        self.torque_now_nm = self._direction * sum(self._torques) / len(self._torques)
        self.travel_now_rad = self._direction * (self._angle(inputs) - self._start_rad)

    def begin(self, direction: int) -> None:
        """The ramp starts with the next sample."""
        self._direction = direction
        if not self._rows:
            return
        self._rows = deque(list(self._rows)[-_BEFORE:], maxlen=_LONGEST)
        self._start_ns, newest = self._rows[-1]
        self._start_rad = self._angle(newest)
        self.running = True

    def end(self) -> None:
        """The ramp is over and of no use."""
        self.running = False
        self._rows = deque(list(self._rows)[-_BEFORE:], maxlen=_BEFORE)

    def level(self, guess_nm: float, positive: bool) -> SlideLevel | None:
        """k0 of what was recorded since :meth:`begin`; ends the record."""
        slide = self._slide()
        self.end()
        return slide_level(slide, self._model, positive=positive, guess_nm=guess_nm)

    def _angle(self, inputs: InjectionInputs) -> float:
        angle = inputs.motor_angle_rad
        return angle if math.isfinite(angle) else self._integrated_rad

    def _slide(self) -> Slide:
        stamps = np.array([t for t, _ in self._rows], dtype=np.int64) - self._start_ns
        time_s = stamps * 1e-9
        table = np.array([row for _, row in self._rows], dtype=np.float64)
        columns = dict(zip(InjectionInputs._fields, table.T, strict=True))
        delays = self._model.delays_s
        late = max(delays.of(name) for name in InjectionInputs._fields)
        at = np.arange(-_OFFSET_S, time_s[-1] - late, _STEP_S)

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
