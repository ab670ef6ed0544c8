"""The torque balance as compiled code out of the disk cache."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eps_hil.physics.balance import Floats, Motion, residual_nm, sliding_levels_nm
from eps_hil.physics.effects import added
from eps_hil.physics.effects.effect import Ratios
from eps_hil.physics.friction import (
    bristle_step,
    friction_law,
    friction_torque_nm,
    static_level_nm,
)
from eps_hil.physics.model import load_model
from eps_hil.physics.simulate import drive_of

_MODEL = Path(__file__).parents[2] / "configs" / "reference_rig.yaml"
_AGAIN = """
import sys
import subprocess
import os
from pathlib import Path

import numpy as np
import pytest
from dataclasses import replace
from eps_hil.physics.balance import Motion, residual_nm
from eps_hil.physics.model import load_model

model = load_model({model!r})
effects = tuple(
    {{"effect": name, key: value}}
    for name, key, value in (
        ("motor_torque_gain", "gain", 1.1),
        ("torque_sensor_gain", "gain", 0.9),
        ("viscous_friction", "coefficient_nm_s_per_rad", 1e-4),
    )
)
n = np.linspace(0.0, 1.0, 50)
residual_nm(replace(model, effects=effects), Motion(*([n] * 10)))
"""


def test_read_only_arrays_are_as_good() -> None:
    """As pandas gives them; what is given is not changed."""
    model = load_model(_MODEL)
    given = np.linspace(0.0, 1.0, 50)
    expected = residual_nm(model, Motion(*([given] * 10)))
    locked = given.copy()
    locked.setflags(write=False)
    found = residual_nm(model, Motion(*([locked] * 10)))
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(locked, np.linspace(0.0, 1.0, 50))


@pytest.mark.parametrize(
    "names",
    [
        ["stribeck"],
        ["breakaway_dwell"],
        ["friction_warmup", "breakaway_dwell", "stribeck", "position_dependent_friction"],
    ],
)
def test_levels_along_a_motion_are_the_kernels_sample_by_sample(names: list[str]) -> None:
    """With rests, in which only the bristle tells a direction, and creep."""
    entries = {
        "stribeck": {"level_nm": 0.03, "speed_rad_s": 10.0},
        "breakaway_dwell": {"level_nm": 0.05, "time_s": 0.1, "release_rad": 0.5},
        "friction_warmup": {"amplitude": 0.3, "time_s": 1.0},
        "position_dependent_friction": {"level_nm": 0.02, "centre_m": 0.0, "width_m": 0.01},
    }
    effects = tuple({"effect": name, **entries[name]} for name in names)
    model = replace(load_model(_MODEL), effects=effects)
    law = replace(model.friction, offset_neg_nm=1.3 * model.friction.offset_neg_nm)
    model = replace(model, friction=law)
    m = _with_rests()
    found, _ = residual_nm(model, m)
    drive, bristle, expected, rests = drive_of(model), 0.0, np.empty(len(found)), set()
    for k in range(len(found)):
        speed, force, travel = m.speed_rad_s[k], m.rack_force_n[k], m.travel_rad[k]
        way = next((one for one in (speed, travel, bristle) if one), 0.0)
        rests |= {np.sign(way)} if not speed and not travel else set()
        u = added.instant(m, k, Ratios(drive.sensor_to_rotor, drive.ratio))
        level = added.level_nm(drive.effects, u, static_level_nm(way, force, drive.law))
        bristle = bristle_step(bristle, travel, abs(travel), level, drive.law.sigma0_nm_per_rad)
        torque = m.motor_torque_nm[k] + drive.sensor_to_rotor * m.torque_sensor_nm[k]
        torque -= force / drive.ratio + friction_torque_nm(bristle, speed, level, drive.law)
        expected[k] = torque - drive.inertia * m.acceleration_rad_s2[k]
        added.advance(drive.effects, added.crept(m, k, u, 1e-3), 1e-3)
    assert rests > {-1.0, 1.0}
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)


def test_levels_of_a_motion_hold_the_effects() -> None:
    """Eq. 3 by the way it goes, and a Stribeck term on top."""
    model = load_model(_MODEL)
    speed = np.array([-20.0, -2.0, 3.0, 30.0])
    force = np.array([500.0, -800.0, 0.0, 100.0])
    rest = [np.zeros(4)] * 10
    motion = Motion(*rest)._replace(speed_rad_s=speed, rack_force_n=force)
    law = friction_law(model.friction)
    static = [static_level_nm(v, f, law) for v, f in zip(speed, force, strict=True)]
    np.testing.assert_allclose(sliding_levels_nm(model, motion), static)
    effect = {"effect": "stribeck", "level_nm": 0.05, "speed_rad_s": 10.0}
    more = sliding_levels_nm(replace(model, effects=(effect,)), motion) - static
    np.testing.assert_allclose(more, 0.05 * np.exp(-((speed / 10.0) ** 2)), rtol=1e-9)


def _with_rests() -> Motion:
    """Both ways, then each time at rest: first exactly, then creeping back."""
    time = np.asarray(np.arange(6000) * 1e-3, np.float64)
    speed = 12.0 * np.sin(2 * np.pi * 0.5 * time)
    speed[700:1200] = 0.0
    speed[1900:2300] = 0.0
    travel = speed * 1e-3
    travel[1000:1200] = -1e-6
    angle: Floats = np.cumsum(travel)
    rng = np.random.default_rng(4)
    torque, sensor = rng.normal(size=(2, len(time)))
    force = 2000.0 * np.sin(time)
    slip = np.abs(travel)
    acceleration: Floats = np.gradient(speed, 1e-3)
    position = angle / 500.0
    return Motion(time, torque, sensor, force, position, speed, angle, travel, slip, acceleration)


@pytest.mark.slow
def test_a_second_process_compiles_nothing(tmp_path: Path) -> None:
    """Closures are compiled anew in every process that calls them from Python: seconds each."""
    code = _AGAIN.format(model=str(_MODEL))
    more = {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_DEBUG_CACHE": "1"}
    said = [
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, **more},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for _ in range(2)
    ]
    assert "data saved" in said[0]
    assert "data loaded" in said[1]
    assert "data saved" not in said[1]


def test_what_a_law_follows_may_be_known_with_less_noise_than_what_acts() -> None:
    """A stop operator's input without noise; the torque that acts is the noisy one."""
    stop = {
        "effect": "empirical", "form": "dynamic", "where": "motor", "how": "sum",
        "inputs": ["motor_torque_nm"], "memory": ["stop"], "shapes": ["linear"],
        "size": -0.02, "memory_1": 0.02, "range": {"motor_torque_nm": [-9.0, 9.0]},
    }  # fmt: skip
    model = load_model(_MODEL)
    with_stop = replace(model, effects=(stop,))
    m = _with_rests()
    noise = 0.02 * np.random.default_rng(1).standard_normal(len(m.time_s))
    clean = 0.5 * np.sin(0.05 * np.arange(len(m.time_s)))
    noisy = m._replace(motor_torque_nm=clean + noise)
    acts, _ = residual_nm(with_stop, noisy, driving_nm=clean)
    none, _ = residual_nm(model, noisy)
    right, _ = residual_nm(with_stop, m._replace(motor_torque_nm=clean))
    plain, _ = residual_nm(model, m._replace(motor_torque_nm=clean))
    np.testing.assert_allclose(acts - none, right - plain, atol=1e-12)
    assert np.ptp(acts - none) == pytest.approx(0.04, rel=1e-6)
