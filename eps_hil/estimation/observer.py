"""The linear disturbance observer at work: one predict-and-correct step (PAPER eq. 5 to 11)."""

from eps_hil.compiled import kernel
from eps_hil.estimation.setup import Constants, Inputs
from eps_hil.estimation.state import Moment


@kernel
def observer_step(c: Constants, s: Moment, torque: float, u: Inputs) -> None:
    """Predict with the mean torque of the step, correct on the measured outputs (eq. 5 to 11)."""
    mean = 0.5 * (torque + s.torque)
    s.torque = torque
    acceleration = c.inverse_inertia * (mean - s.force / c.ratio)
    s.phi += c.step_s * s.omega + 0.5 * c.step_s * c.step_s * acceleration
    s.omega += c.step_s * acceleration
    e_phi = u.motor_angle_rad - s.phi if c.angle_measured else 0.0
    e_omega = u.motor_speed_rad_s - s.omega
    before = s.force
    s.phi += c.l_phi_phi * e_phi + c.l_phi_omega * e_omega
    s.omega += c.l_omega_phi * e_phi + c.l_omega_omega * e_omega
    s.force += c.l_force_phi * e_phi + c.l_force_omega * e_omega
    s.slope += c.slope_low_pass * ((s.force - before) / c.step_s - s.slope)
