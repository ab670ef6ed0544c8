"""From what happened to what a recording says of it: late, offset, noisy, in steps of the DBC."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eps_hil.proof.truth import Floats
from eps_hil.proof.world import Instruments

SPEED_LATE_S, TORQUE_LATE_S = 0.004, 0.001
"""Delays that the model file knows of (CONTRACT 4)."""
RATE_HZ = 1000.0


@dataclass(frozen=True, slots=True)
class Sensor:
    """Noise (rms) and step of one reported signal, in its own unit; decimals written."""

    rms: float
    step: float
    decimals: int


SENSORS = {
    "motor_torque_nm": Sensor(4e-3, 1e-6, 6),
    "torque_sensor_nm": Sensor(1e-2, 2e-6, 6),
    "motor_speed_rad_s": Sensor(0.25, 1e-4, 4),
    "motor_angle_rad": Sensor(2e-3, 5e-5, 5),
    "rack_force_n": Sensor(3.0, 5e-3, 3),
    "rack_position_m": Sensor(5e-6, 2.5e-8, 9),
    "steering_wheel_angle_rad": Sensor(5e-4, 3.5e-6, 7),
    "steering_wheel_speed_rad_s": Sensor(1e-2, 1.75e-5, 6),
}


def late(values: Floats, seconds: float, drift: float = 0.0) -> Floats:
    """``values`` at 1 kHz as they are ``seconds`` later, with a clock that runs ``drift`` off."""
    if seconds == 0.0 and drift == 0.0:
        return values
    from scipy.interpolate import CubicSpline

    t = np.arange(len(values)) / RATE_HZ
    at = np.clip((t - seconds) * (1.0 + drift), 0.0, t[-1])
    return np.asarray(CubicSpline(t, values)(at))


def play(values: Floats, half_width: float) -> Floats:
    """What follows ``values`` with play of ±half_width."""
    if half_width <= 0.0:
        return values
    out, place = np.empty_like(values), float(values[0])
    for k, value in enumerate(values.tolist()):
        place = min(max(place, value - half_width), value + half_width)
        out[k] = place
    return out


def reported(truth: Mapping[str, Floats], i: Instruments) -> dict[str, Floats]:
    """The signals as the sensors show them, without noise and steps; each (n,) at 1 kHz."""
    sensor = play(truth["torque_sensor_nm"], i.sensor_play_nm)
    speed_late = SPEED_LATE_S + i.speed_late_s
    speed = late(truth["motor_speed_rad_s"], speed_late, i.speed_drift)
    angle = late(truth["motor_angle_rad"], speed_late, i.speed_drift)
    if i.encoder_step_rad > 0.0:
        angle = np.round(angle / i.encoder_step_rad) * i.encoder_step_rad
        speed = np.gradient(_moving_mean(angle, 5)) * RATE_HZ
    return {
        "motor_torque_nm": late(truth["motor_torque_nm"], TORQUE_LATE_S),
        "torque_sensor_nm": i.sensor_gain * sensor + i.sensor_offset_nm,
        "motor_speed_rad_s": speed,
        "motor_angle_rad": angle,
        "rack_force_n": truth["rack_force_n"],
        "rack_position_m": truth["rack_position_m"],
        "steering_wheel_angle_rad": truth["steering_wheel_angle_rad"],
        "steering_wheel_speed_rad_s": truth["steering_wheel_speed_rad_s"],
    }


def measured(
    clean: Mapping[str, Floats], i: Instruments, rng: np.random.Generator
) -> dict[str, Floats]:
    """A recording: ``clean`` with noise, rounded to the steps that the bus can carry."""
    n = len(clean["motor_torque_nm"])
    columns = {"time_s": np.round(np.arange(n) / RATE_HZ, 3)}
    for name, values in clean.items():
        sensor = SENSORS[name]
        # heavy tails: Student's t with 3 degrees of freedom, scaled to the same rms
        tails = i.heavy_tails
        noise = rng.standard_t(3.0, n) / np.sqrt(3.0) if tails else rng.standard_normal(n)
        noisy = values + i.noise * sensor.rms * noise
        columns[name] = np.round(np.round(noisy / sensor.step) * sensor.step, sensor.decimals)
    return columns


def _moving_mean(values: Floats, n: int) -> Floats:
    padded = np.pad(values, (n // 2, n // 2), mode="edge")
    return np.convolve(padded, np.ones(n) / n, mode="valid")
