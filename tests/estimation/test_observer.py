"""The disturbance observer's design against independent derivations."""

import numpy as np
import pytest
from scipy.linalg import expm

from eps_hil.estimation.observer_design import design, transition
from eps_hil.estimation.rack_force import RackForceEstimator
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Inputs
from eps_hil.physics.model import Model

DT = 1e-3


def test_transition_is_the_matrix_exponential(reference_model: Model) -> None:
    j, i = reference_model.inertia_kg_m2, reference_model.rack_to_rotor_ratio_rad_per_m
    continuous = np.zeros((4, 4))
    continuous[0, 1] = 1.0
    continuous[1, 2] = -1 / (i * j)  # E of eq. 7
    continuous[1, 3] = 1 / j  # B of eq. 6
    exact = expm(continuous * DT)
    a, b = transition(reference_model, DT)
    assert np.allclose(a, exact[:3, :3], rtol=1e-12, atol=0)
    assert np.allclose(b, exact[:3, 3], rtol=1e-12, atol=0)


@pytest.mark.parametrize("angle", [pytest.param(False, marks=pytest.mark.slow), True])
def test_gain_is_the_kalman_filters(reference_model: Model, angle: bool) -> None:
    """Iterate the covariance by hand (predict, correct) and meet the Riccati solution."""
    settings = EstimatorSettings()
    found = design(reference_model, settings, angle=angle, speed=True, dt=DT)
    a, b = found.transition, found.input
    c = np.eye(3)[[0, 1] if angle else [1]]
    r = np.diag([settings.angle_noise_rad**2, settings.speed_noise_rad_s**2])[
        not angle :, not angle :
    ]
    q = np.outer(b, b) * settings.torque_noise_nm**2
    q[2, 2] += settings.force_walk_n_per_sqrt_s**2 * DT
    p = np.eye(3)
    for _ in range(20_000):
        if not angle:  # φ is unobservable: leave it out of the recursion
            p[0, :] = p[:, 0] = 0.0
        p = a @ p @ a.T + q
        k = p @ c.T @ np.linalg.inv(c @ p @ c.T + r)
        p = (np.eye(3) - k @ c) @ p
    rows = slice(0, 3) if angle else slice(1, 3)
    assert np.allclose(found.gain[rows, not angle :], k[rows], rtol=1e-6)


@pytest.mark.parametrize("walk", [30.0, 100.0, 1000.0])
@pytest.mark.parametrize("angle", [False, True])
def test_observer_is_stable(reference_model: Model, walk: float, angle: bool) -> None:
    settings = EstimatorSettings(force_walk_n_per_sqrt_s=walk)
    found = design(reference_model, settings, angle=angle, speed=True, dt=DT)
    closed = (np.eye(3) - np.hstack([found.gain, np.zeros((3, 1))])) @ found.transition
    part = slice(0 if angle else 1, 3)
    assert np.max(np.abs(np.linalg.eigvals(closed[part, part]))) < 1.0


@pytest.mark.parametrize("walk", [30.0, 100.0, 1000.0])
def test_lag_is_what_a_ramp_shows(reference_model: Model, walk: float) -> None:
    """A rack force that grows steadily is estimated ``lag_s`` late, counted on a clean ramp."""
    settings = EstimatorSettings(
        force_walk_n_per_sqrt_s=walk,
        friction_compensation=False,
        dead_zone=False,
        limiter=False,
    )
    estimator = RackForceEstimator(reference_model, settings)
    j, i = reference_model.inertia_kg_m2, reference_model.rack_to_rotor_ratio_rad_per_m
    rate = 5000.0
    for k in range(1500):
        t = k * DT
        speed = -rate * t**2 / 2 / (i * j)  # the exact answer of a frictionless rotor
        out = estimator.step(Inputs(0.0, 0.0, speed))
    assert rate * (t - estimator.lag_s) == pytest.approx(out.rack_force_n, abs=rate * 2e-6)


@pytest.mark.slow
def test_noise_gains_are_what_noise_shows(reference_model: Model) -> None:
    found = design(reference_model, EstimatorSettings(), angle=False, speed=True, dt=DT)
    rng = np.random.default_rng(0)
    a, b, gain = found.transition[1:, 1:], found.input[1:], found.gain[1:, 1]
    for gain_of, speed_noise, torque_noise in (
        (found.speed_noise_gain, 1.0, 0.0),
        (found.torque_noise_gain, 0.0, 1.0),
    ):
        x, seen = np.zeros(2), []
        for _ in range(60_000):
            x = a @ x + b * torque_noise * rng.standard_normal()
            x = x + gain * (speed_noise * rng.standard_normal() - x[0])
            seen.append(x[0])
        assert np.var(seen) == pytest.approx(gain_of, rel=0.1)


def test_a_larger_walk_is_a_faster_and_noisier_observer(reference_model: Model) -> None:
    slow, fast = (
        design(
            reference_model,
            EstimatorSettings(force_walk_n_per_sqrt_s=walk),
            angle=False,
            speed=True,
            dt=DT,
        )
        for walk in (50.0, 500.0)
    )
    assert fast.lag_s < slow.lag_s
    assert fast.speed_noise_gain > slow.speed_noise_gain
