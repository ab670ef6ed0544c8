"""A rig with known missing physics, in code of its own: what the diagnosis is developed against.

Nothing of ``eps_hil`` is imported. One mass, LuGre friction (eq. 1 to 3) integrated explicitly at
20 kHz with the exact bristle only where explicit Euler would diverge, the motor as spring-damper
at 1 kHz, and every effect of CONTRACT 8 written from its equation.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

Array = npt.NDArray[np.floating[Any]]

SUBSTEPS = 20
REST = 0.05
(
    K0P, K0N, KWP, KWN, KRP, KRN, S0, S1, WS, INERTIA, RATIO, STRIB, STRIB_W, VISC, QUAD,
    POSF, POSC, POSW, DWELL, DWELL_T, DWELL_R, WARM, WARM_T, SCREW, SCREW_P, COG, COG_N, COG_P,
    RIP, RIP_P, CARD, CARD_P, SAT, SPRING, STOP_X, STOP_K, EM_GAIN, EM_OFF,
    HAND, EDDY, EDDY_W, COG2, COG2_N, COG2_P, SMOOTH, SLIP,
) = range(46)  # fmt: skip
_BASE = [
    5.6e-2, 1.258e-1, 4.195e-4, 6.658e-5, 4.993e-5, 4.345e-5, 4.5, 0.075, 0.75, 2.0e-4, 2513.0,
    0, 1, 0, 0, 0, 0, 1, 0, 1, 1, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1e9, 0, 1, 0,
    1, 0, 1, 0, 1, 0, 0, 0,
]  # fmt: skip
PINION, BELT, POLES = 125.7, 2.8, 4


@njit(cache=True)
def _slip(p, held, level, way):  # type: ignore[no-untyped-def]
    """Generalised Maxwell slip: springs that stick, each up to its share of the level."""
    total = 0.0
    for i in range(len(held)):
        most = level * (1 + (i > 1)) / 8
        held[i] += p[SLIP] * p[S0] * way / 2 ** (0.8 * i) / 2.1
        held[i] = min(max(held[i], -most), most)
        total += held[i]
    return total


@njit(cache=True)
def _integrate(p, force, hand, stiffness, damping, out):  # type: ignore[no-untyped-def]
    dt = 1e-3 / SUBSTEPS
    w, phi, z, aged, t, held = 0.0, 0.0, 0.0, 0.0, 0.0, np.zeros(5)
    for k in range(len(force) - 1):
        command = -stiffness * phi - damping * w
        for j in range(SUBSTEPS):
            a = j / SUBSTEPS
            f = force[k] + a * (force[k + 1] - force[k])
            ts = hand[k] + a * (hand[k + 1] - hand[k])
            x = phi / p[RATIO]
            if w >= 0:
                level = p[K0P] + p[KWP] * w + p[KRP] * abs(f)
            else:
                level = p[K0N] - p[KWN] * w + p[KRN] * abs(f)
            level += p[STRIB] * math.exp(-((w / p[STRIB_W]) ** 2))
            level += p[POSF] * math.exp(-(((x - p[POSC]) / p[POSW]) ** 2))
            level += p[DWELL] * aged
            level *= 1 + p[WARM] * math.exp(-t / p[WARM_T])
            rate = w - abs(w) * p[S0] * z / level
            tf = p[S0] * z + p[S1] * math.exp(-((w / p[WS]) ** 2)) * rate
            if p[SMOOTH] > 0:  # no presliding: a function of speed alone
                tf = level * math.tanh(w / p[SMOOTH])
            if p[SLIP] > 0:  # slip elements that share stiffness and level, see _slip
                tf = _slip(p, held, level, dt * w)
            tem = p[EM_GAIN] * command + p[EM_OFF]
            tem = tem / (1 + p[SAT] * tem * tem)
            tem = tem * (1 + p[RIP] * math.sin(6 * POLES * phi + p[RIP_P]))
            ths = ts * (1 + p[CARD] * math.cos(2 * phi * PINION / p[RATIO] + p[CARD_P]))
            extra = p[VISC] * w + p[QUAD] * w * abs(w) + p[SPRING] * phi
            extra += p[SCREW] * math.sin(phi / BELT + p[SCREW_P])
            extra += p[COG] * math.sin(p[COG_N] * phi + p[COG_P])
            extra += p[COG2] * math.sin(p[COG2_N] * phi + p[COG2_P])
            extra += p[EDDY] * 2 * (w / p[EDDY_W]) / (1 + (w / p[EDDY_W]) ** 2)
            if abs(x) > p[STOP_X]:
                extra += math.copysign(p[STOP_K] * (abs(x) - p[STOP_X]), x) / p[RATIO]
            if j == 0:
                out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = command, w, phi, x, tf
            aged *= math.exp(-abs(w) * dt / p[DWELL_R])
            if abs(w) < REST:
                aged += (1 - aged) * dt / p[DWELL_T]
            w += dt / p[INERTIA] * (tem + PINION / p[RATIO] * ths - f / p[RATIO] - tf - extra)
            phi += dt * w
            decay = abs(w) * p[S0] * dt / level
            zss = math.copysign(level / p[S0], w)
            z = zss + (z - zss) * math.exp(-decay) if decay > 0.05 else z + dt * rate
            t += dt
    out[-1] = out[-2]


@dataclass(frozen=True)
class Effects:
    """Plant numbers changed, and what the sensors do wrong."""

    plant: Mapping[int, float]
    sensor_gain: float = 1.0
    sensor_offset: float = 0.0
    speed_late_s: float = 0.0
    torque_late_s: float = 0.0
    torque_lag_s: float = 0.0
    """Time constant of a low-pass between what is asked for, and reported, and the shaft."""


def _late(values: Array, seconds: float) -> Array:
    t = np.arange(len(values)) * 1e-3
    return np.asarray(np.interp(t - seconds, t, values))


def record(
    effects: Effects, manoeuvre: str, seed: int, noise: float = 1.0, seconds: float = 30.0
) -> dict[str, Array]:
    """One recording (1 kHz) of a manoeuvre: sweep, weave, slow, free, once, twice or steps."""
    rng = np.random.default_rng(seed)
    p = np.array(_BASE, dtype=np.float64)
    for place, value in effects.plant.items():
        p[place] = value
    t = np.arange(round(seconds * 1000)) * 1e-3
    force, hand, hz, damping = _excitation(manoeuvre, t, rng)
    hand = p[HAND] * hand
    out = np.zeros((len(t), 5))
    stiffness = 2.0e-4 * (2 * math.pi * hz) ** 2
    _integrate(p, force, hand, stiffness, damping, out)
    torque, speed, angle, position, _ = out.T

    def measured(true: Array, sigma: float, quantum: float) -> Array:
        noisy = true + noise * sigma * rng.standard_normal(len(true))
        return np.round(noisy / quantum) * quantum

    asked = torque + effects.torque_lag_s * np.gradient(torque, 1e-3)
    return {
        "time_s": t,
        "motor_torque_nm": measured(_late(asked, 1e-3 - effects.torque_late_s), 3e-3, 2e-3),
        "torque_sensor_nm": measured(
            hand * effects.sensor_gain + effects.sensor_offset, 1e-2, 5e-3
        ),
        "motor_speed_rad_s": measured(_late(speed, 4e-3 + effects.speed_late_s), 0.2, 0.02),
        "motor_angle_rad": measured(_late(angle, 4e-3 + effects.speed_late_s), 1e-3, 1e-3),
        "rack_force_n": measured(force, 4.0, 1.0),
        "rack_position_m": measured(position, 1e-6, 1e-6),
    }


def _excitation(
    manoeuvre: str, t: Array, rng: np.random.Generator
) -> tuple[Array, Array, float, float]:
    a, b = rng.uniform(0.85, 1.15, 2)
    two_pi = 2 * np.pi
    if manoeuvre == "sweep":
        top = 3.0 / t[-1]
        return (
            750 * a * np.sin(np.pi * top * t**2),
            1.5 * np.sin(two_pi * 0.13 * b * t),
            1.7,
            1e-3,
        )
    if manoeuvre == "weave":
        return (
            900 * a * np.sin(two_pi * 0.22 * b * t) + 300 * np.sin(two_pi * 0.05 * t + 1),
            2.5 * a * np.sin(two_pi * 0.31 * b * t + 0.7),
            1.0,
            1.5e-3,
        )
    if manoeuvre == "slow":
        return (
            600 * a * np.sin(two_pi * 0.06 * t) + 500 * np.sin(two_pi * 0.11 * b * t),
            4.0 * np.sin(two_pi * 0.035 * t),
            0.6,
            4e-3,
        )
    if manoeuvre.startswith("free"):  # no load on the rack: hands alone
        swing = 7.0 * np.sin(two_pi * 0.23 * a * t) + 4.0 * np.sin(two_pi * 0.61 * b * t + 1)
        return np.zeros(len(t)), swing, 0.9, 1.5e-3
    if manoeuvre.startswith(("once", "twice")):  # away from where it begins; back; and again
        turns = 0.25 if manoeuvre.startswith("once") else 1.0
        way = 1 - np.abs(1 - 4 * ((turns * t / t[-1]) % 0.5))
        wave = 60 * np.sin(two_pi * 1.3 * a * t) + 40 * np.sin(two_pi * 0.41 * b * t)
        return wave - 1600 * way, np.zeros(len(t)), 0.6, 4e-3
    levels = rng.uniform(-1200, 1200, int(t[-1] / 1.5) + 2)
    raw = levels[(t / 1.5).astype(int)]
    kernel = np.ones(150) / 150
    force = np.convolve(np.pad(raw, (75, 74), mode="edge"), kernel, mode="valid")
    return force, 2.0 * np.sin(two_pi * 0.1 * b * t), 1.2, 2e-3
