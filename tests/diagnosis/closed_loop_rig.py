"""A rig under its own controller, in code of its own: Dahl friction against a spring or a weight.

Nothing of ``eps_hil`` is imported. The controller's torque is held for 1 ms, the plant runs at
20 kHz, and sensors report what is there, with noise.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

Array = npt.NDArray[np.floating[Any]]

STEP_S, SUBSTEPS = 1e-3, 20


@dataclass(frozen=True)
class Rig:
    """SI units at the rotor; the spring's at the rack, ``ratio`` rad of rotor for a metre."""

    inertia: float
    level_pos: float
    level_neg: float
    drag: float
    grows: float
    stiffness: float
    ratio: float
    spring: float = 0.0
    weight: float = 0.0
    swing_rad: float = 30.0
    speed_loop: bool = True
    push: float = 0.0
    """Constant rack force beside the spring's, N."""


@njit(cache=True)
def _run(numbers, ahead, speed_loop, out):  # type: ignore[no-untyped-def]
    inertia, pos, neg, drag, grows, stiffness, ratio, spring, weight, push, gain, more = numbers
    w, phi, z, summed, h = 0.0, ahead[0] if not speed_loop else 0.0, 0.0, 0.0, STEP_S / SUBSTEPS
    for k in range(len(ahead)):
        if speed_loop:
            summed += more * (ahead[k] - w) * STEP_S
            torque = gain * (ahead[k] - w) + summed
        else:
            torque = gain * (more * (ahead[k] - phi) - w)
        out[k, 0], out[k, 1], out[k, 2] = torque, w, phi
        out[k, 3] = push + spring * phi / ratio
        for _ in range(SUBSTEPS):
            force = push + spring * phi / ratio
            level = (pos + drag * w if w >= 0 else neg - drag * w) + grows * abs(force)
            end = math.copysign(level / stiffness, w)
            z = end + (z - end) * math.exp(-abs(w) * stiffness / level * h)
            pull = force / ratio + weight * math.sin(phi + 0.4)
            w += h / inertia * (torque - pull - stiffness * z)
            phi += h * w


def record(rig: Rig, seed: int, seconds: float, noise: tuple[float, ...]) -> dict[str, Array]:
    """At 1 kHz, with ``noise`` of torque (Nm), speed (rad/s), angle (rad) and force (N)."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds / STEP_S)) * STEP_S
    phase, hz = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.08, 0.3, 3) * (1, 2, 3)
    waves = np.sin(2 * np.pi * np.outer(t, hz) + phase)
    path = rig.swing_rad * (waves @ np.array([0.6, 0.3, 0.1]))
    fast = 2 * np.pi * 8.0
    if rig.speed_loop:
        ahead, loop = np.gradient(path - path[0], STEP_S), (rig.inertia * fast * 2, 0.0)
        loop = (loop[0], loop[0] * fast / 3)
    else:
        ahead, loop = path, (rig.inertia * fast * 3, fast)
    plant = (rig.inertia, rig.level_pos, rig.level_neg, rig.drag, rig.grows, rig.stiffness,
             rig.ratio, rig.spring, rig.weight, rig.push)  # fmt: skip
    out = np.zeros((len(t), 4))
    _run((*plant, *loop), ahead, rig.speed_loop, out)
    names = ("motor_torque_nm", "motor_speed_rad_s", "motor_angle_rad", "rack_force_n")
    seen = out + rng.standard_normal(out.shape) * np.array(noise)
    return {"time_s": t, **dict(zip(names, seen.T, strict=True))}
