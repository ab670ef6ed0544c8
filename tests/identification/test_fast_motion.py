"""The bristle in fast motion: what is held beside it, and what samples do not show.

The rig is one mass with LuGre friction (eq. 1 to 3) in code of its own, swung by a spring-damper.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numba import njit

from eps_hil.identification.identify import identify
from eps_hil.physics.model import Delays, Model
from eps_hil.series import Series

pytestmark = pytest.mark.slow

TRUE: dict[str, Any] = {
    "inertia": 2e-4,
    "pos": (0.056, 4.195e-4, 4.993e-5),
    "neg": (0.1258, 6.658e-5, 4.345e-5),
    "sigma0": 4.5,
    "sigma1": 0.075,
    "speed": 0.75,
}
RATIO, STIFFNESS, DAMPING, STEPS = 2513.0, 0.6, 0.01, 10
SENSORS = {"motor_torque_nm": 4e-3, "motor_speed_rad_s": 0.25, "motor_angle_rad": 2e-3,
           "rack_force_n": 3.0}  # fmt: skip


@njit
def _swing(inertia, pos, neg, sigma0, sigma1, slow, path, force, out):  # type: ignore[no-untyped-def]
    w, phi, z, dt = 0.0, 0.0, 0.0, 1e-3 / STEPS
    for k in range(len(path) - 1):
        for j in range(STEPS):
            wanted = path[k] + j / STEPS * (path[k + 1] - path[k])
            load = force[k] + j / STEPS * (force[k + 1] - force[k])
            torque = STIFFNESS * (wanted - phi) - DAMPING * w
            if j == 0:
                out[0, k], out[1, k], out[2, k], out[3, k] = torque, w, phi, load
            side = pos if w >= 0 else neg
            level = side[0] + side[1] * abs(w) + side[2] * abs(load)
            rate = w - abs(w) * sigma0 * z / level
            end = np.sign(w) * level / sigma0
            after = end + (z - end) * np.exp(-abs(w) * sigma0 / level * dt)
            friction = 0.5 * sigma0 * (z + after) + sigma1 * np.exp(-((w / slow) ** 2)) * rate
            z = after
            before = w
            w += dt * (torque - load / RATIO - friction) / inertia
            phi += 0.5 * dt * (before + w)


def recording(seed: int, hz: float, swing_rad: float, seconds: int) -> Mapping[str, Series]:
    """Reported without delay, with noise; up to ``hz``, with a slow load of 800 N."""
    rng = np.random.default_rng(seed)
    t = np.arange(seconds * 1000 + 1) * 1e-3
    tones = hz * rng.uniform(0.3, 1.0, 5)
    path = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in tones)
    force = 800 * np.sin(2 * np.pi * 0.23 * t) + 600 * np.sin(2 * np.pi * 0.41 * t)
    out = np.zeros((4, len(t)))
    numbers = [TRUE[key] for key in ("inertia", "pos", "neg", "sigma0", "sigma1", "speed")]
    _swing(*numbers, swing_rad * path / np.std(path), force, out)
    t_ns = np.arange(seconds * 1000) * 1_000_000
    return {
        name: Series(t_ns, one[:-1] + size * rng.standard_normal(len(t_ns)))
        for (name, size), one in zip(SENSORS.items(), out, strict=True)
    }


@pytest.mark.parametrize("seed", [1, 2])
def test_a_fast_swing_leaves_the_bristle_open(reference_model: Model, seed: int) -> None:
    """A tenth of a per mille of the inertia's torque is a bristle there, and no sample is slow."""
    model = replace(reference_model, delays_s=Delays(0.0, 0.0, 0.0, 0.0))
    found = identify({"fast": recording(seed, 12.0, 15.0, 60)}, model).parameters
    stiffness = found["friction.sigma0_nm_per_rad"]
    if stiffness.ci95 is not None:
        low, high = stiffness.ci95
        assert low < TRUE["sigma0"] < high
    for name in ("friction.sigma1_nm_s_per_rad", "friction.sigma1_speed_rad_s"):
        assert found[name].status == "kept"
