"""Design of the linear disturbance observer (PAPER eq. 5 to 11): matrices, gain, exact lag.

States [φ, ω, F_r]: rotor angle (rad), rotor speed (rad/s), rack force (N, at the rack).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.physics.model import Model

Matrix = npt.NDArray[np.float64]

_SLOW_RAD_S = 2.0 * np.pi * 0.02


@dataclass(frozen=True, slots=True)
class Observer:
    """Discrete observer x⁺ = A x + B u, then x += L (y − C x): A (3,3), B (3,), L (3,2).

    A column of ``gain`` is zero where that output (φ, ω) is not measured. ``lag_s`` is the group
    delay from true rack force to observed force for slow forces; ``speed_noise_gain`` and
    ``torque_noise_gain`` are the variance of the observed speed per variance of white noise on
    the measured speed and on the torque.
    """

    transition: Matrix
    input: Matrix
    gain: Matrix
    lag_s: float
    speed_noise_gain: float
    torque_noise_gain: float


def design(
    model: Model, settings: EstimatorSettings, *, angle: bool, speed: bool, dt: float
) -> Observer:
    """The observer for a model; ``angle`` and ``speed`` say which outputs are measured.

    The gain is the steady Kalman gain: its covariance solves the discrete Riccati equation for
    ẋ_d = 0 driven by ``force_walk`` and motor-torque noise, with the sensors' noise as given.
    """
    from scipy.linalg import solve_discrete_are

    a, b = transition(model, dt)
    rows = [i for i, measured in enumerate((angle, speed)) if measured]
    noise = np.diag([settings.angle_noise_rad**2, settings.speed_noise_rad_s**2])[
        np.ix_(rows, rows)
    ]
    c = np.eye(3)[rows]
    walk = np.zeros((3, 3))
    walk[2, 2] = settings.force_walk_n_per_sqrt_s**2 * dt
    walk += np.outer(b, b) * settings.torque_noise_nm**2
    if not angle:  # φ is integrated only: it is not observable, and needs no gain
        a_part, c_part, q_part = a[1:, 1:], c[:, 1:], walk[1:, 1:]
    else:
        a_part, c_part, q_part = a, c, walk
    p = solve_discrete_are(a_part.T, c_part.T, q_part, noise)
    k = p @ c_part.T @ np.linalg.inv(c_part @ p @ c_part.T + noise)
    gain = np.zeros((3, 2))
    gain[3 - len(k) :, rows] = k
    if not angle:
        gain[0, :] = gain[1, :] * 0.0
    lag = _lag(model, a, b, gain, dt)
    speed_in, torque_in = _noise_gains(a, b, gain)
    return Observer(a, b, gain, lag, speed_in, torque_in)


def transition(model: Model, dt: float) -> tuple[Matrix, Matrix]:
    """A (3,3) and B (3,) of eq. 5 to 9 for a torque and a rack force held over ``dt``; exact."""
    per_torque = 1.0 / model.inertia_kg_m2
    per_force = -per_torque / model.rack_to_rotor_ratio_rad_per_m
    a = np.array([[1.0, dt, per_force * dt**2 / 2], [0.0, 1.0, per_force * dt], [0.0, 0.0, 1.0]])
    b = np.array([per_torque * dt**2 / 2, per_torque * dt, 0.0])
    return a, b


def force_response(
    a: Matrix, b: Matrix, gain: Matrix, ratio: float, dt: float, frequency_rad_s: float
) -> complex:
    """F̂/F of the observer at one frequency, for a rack force that moves the rotor as in eq. 1d.

    The plant integrates the mean of two neighbouring force samples, as the estimator does with
    its torque; measured outputs are the plant's own φ and ω.
    """
    z = np.exp(1j * frequency_rad_s * dt)
    plant_a, plant_b = a[:2, :2], -b[:2] / ratio
    plant = np.linalg.solve(z * np.eye(2) - plant_a, plant_b * (1 + z) / 2)
    closed = (np.eye(3) - np.hstack([gain, np.zeros((3, 1))])) @ a
    # x(k) = (I − L C) A x(k−1) + L y(k)
    measured = gain != 0
    states = np.linalg.solve(np.eye(3) - closed / z, (gain * measured) @ plant)
    return complex(states[2])


def _lag(model: Model, a: Matrix, b: Matrix, gain: Matrix, dt: float) -> float:
    ratio = model.rack_to_rotor_ratio_rad_per_m
    # φ without a gain is a free integrator that nothing reads; leave it out of the solve.
    if not gain[:, 0].any() and not gain[0].any():
        a = a.copy()
        a[0] = 0.0
    response = force_response(a, b, gain, ratio, dt, _SLOW_RAD_S)
    return float(-np.angle(response) / _SLOW_RAD_S)


def _noise_gains(a: Matrix, b: Matrix, gain: Matrix) -> tuple[float, float]:
    """Variance of ω̂ for unit white noise on the measured speed, and on the torque."""
    from scipy.linalg import solve_discrete_lyapunov

    correction = np.eye(3) - np.hstack([gain, np.zeros((3, 1))])
    part = slice(0 if gain[:, 0].any() else 1, 3)  # φ without a gain: nothing reads it
    closed = (correction @ a)[part, part]

    def variance(entry: Matrix) -> float:
        return float(solve_discrete_lyapunov(closed, np.outer(entry, entry))[-2, -2])

    return variance(gain[part, 1]), variance((correction @ b)[part])
