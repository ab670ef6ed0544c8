"""The tuning curve against the estimator itself, ramps, and noise that is known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.rack_force import RackForceEstimator
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.tuning import (
    Noise,
    advise,
    assumed_noise,
    curve,
    dwell_noise,
    point,
    simulated_noise_n,
)
from eps_hil.physics.model import Model
from eps_hil.series import Series

BARE = EstimatorSettings(friction_compensation=False, dead_zone=False, limiter=False)


@pytest.mark.parametrize("walk", [50.0, 100.0, 800.0])
@pytest.mark.parametrize("low_pass", [True, False])
def test_noise_is_what_the_estimator_shows(
    reference_model: Model, walk: float, low_pass: bool
) -> None:
    """Without friction in the way: 60 s of white noise on speed and torque, 6 %."""
    settings = replace(BARE, force_walk_n_per_sqrt_s=walk, low_pass=low_pass)
    for noise in (Noise(0.3, 0.0, ""), Noise(0.0, 5e-3, ""), Noise(0.3, 5e-3, "")):
        expected = point(reference_model, settings, noise).noise_n
        found = simulated_noise_n(reference_model, settings, noise, seconds=60.0)
        assert found == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize("every", [2, 10])
def test_noise_of_slower_samples_is_what_the_estimator_shows(
    reference_model: Model, every: int
) -> None:
    """Drawn straight between samples, noise is slower and hardly less: 2.9 N was said of 5.1 N."""
    for speed, torque in ((0.3, 0.0), (0.0, 5e-3)):
        noise = Noise(speed, torque, "", every * 1e-3 * (speed > 0), every * 1e-3 * (torque > 0))
        expected = point(reference_model, BARE, noise).noise_n
        found = simulated_noise_n(reference_model, BARE, noise, seconds=60.0)
        assert found == pytest.approx(expected, rel=0.08)
        assert found > 1.2 * point(reference_model, BARE, Noise(speed, torque, "")).noise_n


def test_the_load_dependence_of_friction_takes_some_noise_off(reference_model: Model) -> None:
    """T_fs follows |F̂|: what adds to F̂ adds k_r F̂ to the friction, so F̂ is 1/(1 + k_r i) as loud
    (sliding forward under a positive force, for noise slower than the observer)."""
    noise = Noise(0.3, 5e-3, "")
    settings = EstimatorSettings()
    share = (
        simulated_noise_n(reference_model, settings, noise, seconds=60.0)
        / point(reference_model, settings, noise).noise_n
    )
    slow = 1.0 / (1.0 + reference_model.friction.load_pos_nm_per_n * 2513.0)
    assert slow - 0.05 < share < 1.0


def test_bandwidth_is_where_a_sine_loses_its_third(reference_model: Model) -> None:
    """A frictionless rotor under a sine of rack force at the −3 dB frequency."""
    found = point(reference_model, BARE, assumed_noise(BARE))
    j, i = reference_model.inertia_kg_m2, reference_model.rack_to_rotor_ratio_rad_per_m
    omega = 2 * np.pi * found.bandwidth_hz
    estimator = RackForceEstimator(reference_model, BARE)
    seen = []
    for k in range(6000):
        t = k * 1e-3
        speed = (np.cos(omega * t) - 1.0) * 100.0 / (omega * i * j)
        out = estimator.step(Inputs(0.0, 0.0, float(speed)))
        seen.append(out.rack_force_n)
    assert np.sqrt(2.0) * np.std(seen[-3000:]) == pytest.approx(100.0 / np.sqrt(2.0), rel=0.05)


def test_delay_is_the_estimators_own(reference_model: Model) -> None:
    for settings in (BARE, replace(BARE, low_pass=False), EstimatorSettings()):
        found = point(reference_model, settings, Noise(0.3, 5e-3, ""))
        assert found.delay_s == pytest.approx(RackForceEstimator(reference_model, settings).lag_s)


def test_a_faster_observer_is_louder(reference_model: Model) -> None:
    settings = EstimatorSettings()
    points = curve(reference_model, settings, assumed_noise(settings))
    assert np.all(np.diff([p.noise_n for p in points]) > 0)
    assert np.all(np.diff([p.delay_s for p in points]) < 0)
    assert np.all(np.diff([p.bandwidth_hz for p in points]) >= 0)
    for p in points:
        assert p.noise_n == pytest.approx(np.hypot(p.speed_share_n, p.torque_share_n))


def test_advice_follows_from_the_curve(reference_model: Model) -> None:
    settings = EstimatorSettings()
    noise = assumed_noise(settings)
    now, points = point(reference_model, settings, noise), curve(reference_model, settings, noise)
    calm, half, fast = advise(now, points)
    assert f"{now.noise_n:.1f} N rms" in calm
    assert half.startswith("Half the noise")
    assert fast.startswith("Half the delay")
    assert any("go faster" in one for one in advise(now, points, signal_hz=20.0))


def test_noise_is_taken_from_the_rests(reference_model: Model, steps_truth: Any) -> None:
    """The independent rig's own noise: 0.3 rad/s, 3 mNm and 5 mNm at the bar, all quantised."""
    t_ns = np.round(steps_truth.columns["time_s"] * 1e9).astype(np.int64)
    names = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s")
    series = {n: Series(t_ns, np.asarray(steps_truth.columns[n])) for n in names}
    found = dwell_noise(series, reference_model)
    assert found is not None
    assert found.speed_rad_s == pytest.approx(0.3, rel=0.05)
    assert found.torque_nm == pytest.approx(3e-3, rel=0.1)
    assert "rest" in found.origin
    assert (found.speed_period_s, found.torque_period_s) == (1e-3, 1e-3)
    slow = {n: Series(t_ns[:: 1 + 4 * (n == names[2])], one.value[:: 1 + 4 * (n == names[2])])
            for n, one in series.items()}  # fmt: skip
    slower = dwell_noise(slow, reference_model)
    assert slower is not None
    assert slower.speed_rad_s == pytest.approx(0.3, rel=0.1)
    assert (slower.speed_period_s, slower.torque_period_s) == (5e-3, 1e-3)
    moving = {n: Series(t_ns, 50.0 + 0 * one.value) for n, one in series.items()}
    assert dwell_noise(moving, reference_model) is None
    assert dwell_noise({"motor_torque_nm": series["motor_torque_nm"]}, reference_model) is None
