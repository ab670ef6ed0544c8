"""A rig that this project's physics did not simulate: its own equations, integrator, noise.

Written from the paper's equations alone (1, 2, 3), with nothing imported from ``eps_hil``: plain
explicit integration of the LuGre model at 100 kHz, where the package uses the exact update. It
is the judge of the estimator, so it must stay a stranger to it.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

Array = npt.NDArray[np.floating[Any]]

INERTIA, RATIO, PINION = 2.0e-4, 2513.0, 125.7
SUBSTEPS = 100


@dataclass(frozen=True)
class Truth:
    """What happened (1 kHz, physical instants) and what the files say of it."""

    time_s: Array
    rack_force_n: Array
    speed_rad_s: Array
    angle_rad: Array
    friction_nm: Array
    motor_torque_nm: Array
    columns: dict[str, Array]


@njit(cache=True)
def _level(w: float, f: float) -> float:
    if w >= 0:
        return 5.6e-2 + 4.195e-4 * w + 4.993e-5 * abs(f)
    return 1.258e-1 - 6.658e-5 * w + 4.345e-5 * abs(f)


@njit(cache=True)
def _integrate(force, sensor, stiffness, damping, hold, out):  # type: ignore[no-untyped-def]
    """force, sensor: at 1 kHz (n,), linear in between; out (n, 4): torque, speed, angle, T_f."""
    dt = 1e-3 / SUBSTEPS
    w = 0.0
    phi = 0.0
    z = 0.0
    for k in range(len(force) - 1):
        held = -stiffness * phi - damping * w
        for j in range(SUBSTEPS):
            a = j / SUBSTEPS
            f = force[k] + a * (force[k + 1] - force[k])
            ts = sensor[k] + a * (sensor[k + 1] - sensor[k])
            tem = held if hold else -stiffness * phi - damping * w
            zdot = w - abs(w) * 4.5 * z / _level(w, f)
            tf = 4.5 * z + 0.075 * math.exp(-((w / 0.75) ** 2)) * zdot
            if j == 0:
                out[k, 0], out[k, 1], out[k, 2], out[k, 3] = tem, w, phi, tf
            w += dt / INERTIA * (tem + PINION / RATIO * ts - f / RATIO - tf)
            phi += dt * w
            z += dt * zdot
    out[-1] = out[-2]


def _late(values: Array, samples: int) -> Array:
    return np.concatenate([np.full(samples, values[0]), values[: len(values) - samples]])


def run(
    force: Array,
    sensor: Array,
    *,
    resonance_hz: float = 1.6,
    damping: float = 1.0e-3,
    hold: bool = False,
    speed_noise: float = 0.3,
    torque_noise: float = 3e-3,
    sensor_noise: float = 5e-3,
    seed: int = 1,
) -> Truth:
    """Drive the rig with rack force (N) and torsion-bar torque (Nm) at 1 kHz, both shape (n,).

    The EPS motor is a spring-damper; the reported speed is 4 ms late, the torque 1 ms, all with
    noise (standard deviations) and quantisation. ``hold`` holds the motor torque between samples.
    """
    stiffness = INERTIA * (2 * math.pi * resonance_hz) ** 2
    out = np.zeros((len(force), 4))
    _integrate(force, sensor, stiffness, damping, hold, out)
    rng = np.random.default_rng(seed)

    def measured(true: Array, noise: float, quantum: float) -> Array:
        return np.round((true + noise * rng.standard_normal(len(true))) / quantum) * quantum

    time = np.arange(len(force)) * 1e-3
    columns = {
        "time_s": time,
        "motor_torque_nm": measured(_late(out[:, 0], 1), torque_noise, 2e-3),
        "torque_sensor_nm": measured(sensor, sensor_noise, 5e-3),
        "motor_speed_rad_s": measured(_late(out[:, 1], 4), speed_noise, 0.05),
        "motor_angle_rad": measured(_late(out[:, 2], 4), 1e-3, 1e-3),
        "rack_force_n": measured(force, 3.0, 1.0),
    }
    return Truth(time, force, out[:, 1], out[:, 2], out[:, 3], out[:, 0], columns)


def sweep(duration_s: float = 40.0, force_n: float = 764.0, top_hz: float = 4.0) -> Array:
    """Rack force of a sine sweep 0 to ``top_hz``: 540 N rms with the default amplitude."""
    t = np.arange(round(duration_s * 1000)) * 1e-3
    return np.asarray(force_n * np.sin(math.pi * top_hz / duration_s * t**2))


def steps() -> Array:
    """Rack-force steps with rest between them, ending at zero (like fig. 12)."""
    levels = [0.0, 1000.0, 400.0, -200.0, -1000.0, -500.0, 800.0, 0.0]
    raw = np.repeat(np.array(levels), 2500)
    kernel = np.ones(100) / 100
    return np.convolve(np.pad(raw, (50, 49), mode="edge"), kernel, mode="valid")


def weave(duration_s: float = 30.0) -> Array:
    """Slow weave: 0.25 Hz, 900 N with a second, slower component."""
    t = np.arange(round(duration_s * 1000)) * 1e-3
    return np.asarray(900 * np.sin(2 * math.pi * 0.25 * t) + 200 * np.sin(2 * math.pi * 0.11 * t))
