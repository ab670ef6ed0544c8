"""The linear disturbance observer at work: one predict-and-correct step (PAPER eq. 5 to 11)."""

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.estimation.setup import (
    FORCE,
    OMEGA,
    PHI,
    SLOPE,
    STEP_S,
    TORQUE,
    Constants,
    Inputs,
)


@njit
def observer_step(c: Constants, s: npt.NDArray[np.float64], torque: float, u: Inputs) -> None:
    """Predict with the mean torque of the step, correct on the measured outputs (eq. 5 to 11)."""
    mean = 0.5 * (torque + s[TORQUE])
    s[TORQUE] = torque
    acceleration = c.inverse_inertia * (mean - s[FORCE] / c.ratio)
    s[PHI] += STEP_S * s[OMEGA] + 0.5 * STEP_S * STEP_S * acceleration
    s[OMEGA] += STEP_S * acceleration
    e_phi = u.motor_angle_rad - s[PHI] if c.angle_measured else 0.0
    e_omega = u.motor_speed_rad_s - s[OMEGA]
    before = s[FORCE]
    s[PHI] += c.l_phi_phi * e_phi + c.l_phi_omega * e_omega
    s[OMEGA] += c.l_omega_phi * e_phi + c.l_omega_omega * e_omega
    s[FORCE] += c.l_force_phi * e_phi + c.l_force_omega * e_omega
    s[SLOPE] += c.slope_low_pass * ((s[FORCE] - before) / STEP_S - s[SLOPE])
