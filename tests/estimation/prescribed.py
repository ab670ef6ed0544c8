"""Recordings of a prescribed motion: eq. 1 and 2 solved for the motor torque, with sensor noise.

No simulation: rotor speed and rack force are given, so the truth is exact.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from eps_hil.estimation.batch import estimate
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.stream import Trace
from eps_hil.physics.model import Delays, Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]
STEP_S, START_NS = 1e-3, 1_000_000_000
NOISE = {
    "motor_torque_nm": 0.004,
    "torque_sensor_nm": 0.01,
    "motor_speed_rad_s": 0.25,
    "motor_angle_rad": 0.002,
}
SPEED_ONLY = ("motor_torque_nm", "motor_speed_rad_s")


def friction_nm(
    model: Model, speed: Floats, force_n: Floats, level: Callable[[float], float] = lambda nm: nm
) -> Floats:
    """T_f of eq. 2 (Nm, at the rotor) from z = 0; ``level`` changes T_fs (Nm) of eq. 3."""
    f, z, found = model.friction, 0.0, np.empty(len(speed))
    for k, (w, load) in enumerate(zip(speed.tolist(), np.abs(force_n).tolist(), strict=True)):
        side = f.offset_neg_nm, f.viscous_neg_nm_s_per_rad, f.load_neg_nm_per_n
        if (w if w != 0.0 else z) >= 0.0:
            side = f.offset_pos_nm, f.viscous_pos_nm_s_per_rad, f.load_pos_nm_per_n
        most = level(side[0] + side[1] * abs(w) + side[2] * load)
        end = math.copysign(most / f.sigma0_nm_per_rad, w)
        z = end + (z - end) * math.exp(-abs(w) * f.sigma0_nm_per_rad * STEP_S / most)
        damping = f.sigma1_nm_s_per_rad * math.exp(-min((w / f.sigma1_speed_rad_s) ** 2, 60.0))
        rate = w - abs(w) * f.sigma0_nm_per_rad * z / most
        found[k] = f.sigma0_nm_per_rad * z + damping * rate
    return found


@dataclass
class Prescribed:
    """Signals without delay of a motion; ``speed`` (rad/s) and ``force_n`` (n,) are the truth."""

    model: Model
    speed: Floats
    force_n: Floats
    friction: Floats
    added_nm: Floats | float = 0.0
    sensor_nm: Floats | float = 0.0
    first_rad: float = 0.0
    signals: dict[str, Floats] = field(init=False)

    def __post_init__(self) -> None:
        self.model = replace(self.model, delays_s=Delays())
        m, n, rng = self.model, len(self.speed), np.random.default_rng(1)
        kick = m.inertia_kg_m2 * np.gradient(self.speed, STEP_S)
        load = self.force_n / m.rack_to_rotor_ratio_rad_per_m
        sensor = np.zeros(n) + self.sensor_nm
        exact = {
            "motor_torque_nm": kick + load + self.friction + self.added_nm
            - m.sensor_to_rotor * sensor,
            "torque_sensor_nm": sensor,
            "motor_speed_rad_s": self.speed,
            "motor_angle_rad": self.first_rad + STEP_S * np.cumsum(self.speed),
        }  # fmt: skip
        self.signals = {
            name: value + NOISE[name] * rng.standard_normal(n) for name, value in exact.items()
        }

    @property
    def t_ns(self) -> npt.NDArray[np.int64]:
        """Stamps of all signals (n,)."""
        steps = np.arange(len(self.speed), dtype=np.int64)
        return START_NS + steps * round(STEP_S * 1e9)

    def series(self, names: Sequence[str] = tuple(NOISE)) -> dict[str, Series]:
        """The signals of these names as a recording."""
        return {name: Series(self.t_ns, self.signals[name]) for name in names}

    def estimate(
        self, names: Sequence[str] = tuple(NOISE), model: Model | None = None, **settings: object
    ) -> Trace:
        """What is estimated from the signals of these names."""
        chosen = replace(EstimatorSettings(), **settings)  # type: ignore[arg-type]
        return estimate(self.series(names), model or self.model, chosen)

    def error_n(self, trace: Trace) -> Floats:
        """Estimate less truth (N), at the estimate's own instants."""
        truth = np.interp(trace.t_ns - START_NS, self.t_ns - START_NS, self.force_n)
        return np.asarray(trace.rack_force_n - truth)


def at(trace: Trace, since_s: float, until_s: float) -> npt.NDArray[np.bool_]:
    """Rows between two times of the recording."""
    time_s = (trace.t_ns - START_NS) * 1e-9
    return np.asarray((time_s >= since_s) & (time_s < until_s))


def ramp(seconds: float, speed: float, in_s: float = 0.2) -> Floats:
    """A speed that is reached from rest and held."""
    return speed * np.minimum(np.arange(round(seconds / STEP_S)) * STEP_S / in_s, 1.0)
