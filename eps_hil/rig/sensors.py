"""Sensors: what the bus shows of the truth — later, filtered, noisy, in steps of the DBC.

A reported value at time t speaks of t − delay (model file, ``delays_s``). A low-pass filter is
part of that delay, not beside it: its group delay is taken off the dead time, so the delay in the
model file stays right whatever the filter.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, Field, with_config

from eps_hil.compiled import njit
from eps_hil.errors import InputError
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.rig.plant import TOLD, TRUE_SIGNALS

Floats = npt.NDArray[np.float64]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]

REPORTED = (
    "motor_torque_nm",
    "torque_sensor_nm",
    "motor_speed_rad_s",
    "motor_angle_rad",
    "rack_force_n",
    "rack_position_m",
    "steering_wheel_angle_rad",
    "steering_wheel_speed_rad_s",
    "vehicle_speed_m_s",
    "lateral_acceleration_m_s2",
    "yaw_rate_rad_s",
)
"""Signals that a rig has; true friction is not among them."""

NOISE_RMS = {
    "motor_torque_nm": 0.004,
    "torque_sensor_nm": 0.01,
    "motor_speed_rad_s": 0.25,
    "motor_angle_rad": 0.002,
    "rack_force_n": 3.0,
    "rack_position_m": 5e-6,
    "steering_wheel_angle_rad": 5e-4,
    "steering_wheel_speed_rad_s": 0.01,
    "vehicle_speed_m_s": 0.0,  # comes filtered from the vehicle, and never below zero
    "lateral_acceleration_m_s2": 0.02,
    "yaw_rate_rad_s": 0.001,
}
"""Noise of each sensor, rms, in the unit of the signal."""

_NOISE_BLOCK = 100
LONGEST_DRIFT_S = 1.0
"""Lag of a drifting clock at which its buffer is full: it is emptied, and the lag starts anew."""


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class SensorSettings:
    """Choices beside the model file's delays; signals by their canonical names.

    ``noise_rms`` changes single entries of :data:`NOISE_RMS`; ``filters_s`` gives time constants
    of first-order low-pass filters, each at most as long as its signal's delay; ``biases`` are
    added to what is reported.
    """

    noise: bool = True
    quantise: bool = True
    noise_rms: Mapping[str, NotNegative] = field(default_factory=dict)
    filters_s: Mapping[str, NotNegative] = field(default_factory=dict)
    biases: Mapping[str, float] = field(default_factory=dict)


class _Law(NamedTuple):
    column: npt.NDArray[np.int64]  # (m,) of the truth row
    dead: Floats  # (m,) dead time in steps
    keep: Floats  # (m,) of the low-pass
    noise: Floats  # (m,) rms
    bias: Floats  # (m,)
    step: Floats  # (m,) resolution, 0: not quantised
    offset: Floats  # (m,)
    drift: Floats  # (m,) steps of further dead time a step
    longest_drift: float  # in steps


@njit
def _sense(
    law: _Law, ring: Floats, filtered: Floats, count: int, truth: Floats, white: Floats, out: Floats
) -> None:
    size = ring.shape[0]
    ring[count % size] = truth
    for j in range(law.column.size):
        dead = law.dead[j] + (law.drift[j] * count) % law.longest_drift
        whole = int(math.floor(dead))
        part = dead - whole
        # Before the first sample the rig stood as the first sample found it.
        newer, older = max(count - whole, 0), max(count - whole - 1, 0)
        column = law.column[j]
        value = ring[newer % size, column]
        if part > 0.0:
            value += part * (ring[older % size, column] - value)
        if count == 0:
            filtered[j] = value
        filtered[j] = value + (filtered[j] - value) * law.keep[j]
        reported = filtered[j] + law.bias[j] + law.noise[j] * white[j]
        if law.step[j] > 0.0:
            reported = round((reported - law.offset[j]) / law.step[j]) * law.step[j] + law.offset[j]
        out[j] = reported


@njit
def _sense_all(law: _Law, ring: Floats, filtered: Floats, truth: Floats, white: Floats) -> Floats:
    out = np.zeros((truth.shape[0], law.column.size))
    for k in range(truth.shape[0]):
        _sense(law, ring, filtered, k, truth[k], white[k], out[k])
    return out


class Sensors:
    """One set of sensors; the same settings and seed give the same noise, live and offline.

    The model's effects on delays act here; ``drifts_ppm`` are signals' clocks that run slow.

    ``resolution`` maps canonical names to (step, offset) of the DBC; none: not quantised here
    (a frame encoder does it). ``step_s``: from one :meth:`step` to the next.
    """

    def __init__(
        self,
        model: Model,
        settings: SensorSettings,
        seed: int,
        resolution: Mapping[str, tuple[float, float]] | None = None,
        drifts_ppm: Mapping[str, float] | None = None,
        step_s: float = 1e-3,
    ):
        _check_names(settings)
        drifts = drifts_ppm or {}
        self._law = _law(with_model_effects(model), settings, resolution or {}, drifts, step_s)
        depth = int(self._law.dead.max() + (self._law.longest_drift if drifts else 0.0)) + 3
        self._ring = np.zeros((depth, len(TRUE_SIGNALS)))
        self._filtered = np.zeros(len(REPORTED))
        self._random = np.random.default_rng(seed)
        self._white = np.zeros((0, len(REPORTED)))
        self._at = 0
        self._count = 0

    def step(self, truth: Floats, out: Floats) -> None:
        """Reported values of this step into ``out`` (order of :data:`REPORTED`)."""
        if self._at == len(self._white):
            self._white = self._random.standard_normal((_NOISE_BLOCK, len(REPORTED)))
            self._at = 0
        white = self._white[self._at]
        _sense(self._law, self._ring, self._filtered, self._count, truth, white, out)
        self._at += 1
        self._count += 1

    def run(self, truth: Floats) -> Floats:
        """Reported values for all truth rows, from a fresh start; shape (rows, REPORTED)."""
        white = self._random.standard_normal((truth.shape[0], len(REPORTED)))
        return np.asarray(_sense_all(self._law, self._ring, self._filtered, truth, white))


def _check_names(settings: SensorSettings) -> None:
    for what in ("noise_rms", "filters_s", "biases"):
        for name in getattr(settings, what):
            if name not in REPORTED:
                raise InputError(
                    "sensors", f"{what}.{name}", "is no signal of the rig", "use canonical names"
                )


def _law(
    model: Model,
    settings: SensorSettings,
    resolution: Mapping[str, tuple[float, float]],
    drifts_ppm: Mapping[str, float],
    step_s: float,
) -> _Law:
    dead, keep = [], []
    for name in REPORTED:
        delay_s, tau_s = model.delays_s.of(name), settings.filters_s.get(name, 0.0)
        pole = math.exp(-step_s / tau_s) if tau_s > 0 else 0.0
        if name == "motor_torque_nm":
            delay_s = max(delay_s, 0.0)  # a shaft that follows late is in the plant
        rest_s = delay_s - pole / (1.0 - pole) * step_s
        if rest_s < -1e-9:
            raise InputError(
                "sensors",
                f"filters_s.{name}",
                f"a filter of {tau_s:g} s is later than the delay of {delay_s:g} s in the model",
                "shorten the filter or raise the model's delay",
            )
        dead.append(max(rest_s, 0.0) / step_s)
        keep.append(pole)
    noise = [settings.noise_rms.get(n, NOISE_RMS[n]) if settings.noise else 0.0 for n in REPORTED]
    steps = [resolution.get(n, (0.0, 0.0)) if settings.quantise else (0.0, 0.0) for n in REPORTED]
    return _Law(
        np.array([TRUE_SIGNALS.index(TOLD.get(name, name)) for name in REPORTED], dtype=np.int64),
        np.round(np.array(dead), 9),
        np.array(keep),
        np.array(noise, dtype=np.float64),
        np.array([float(settings.biases.get(name, 0.0)) for name in REPORTED]),
        np.array([step for step, _ in steps], dtype=np.float64),
        np.array([offset for _, offset in steps], dtype=np.float64),
        np.array([drifts_ppm.get(name, 0.0) * 1e-6 for name in REPORTED]),
        LONGEST_DRIFT_S / step_s,
    )
