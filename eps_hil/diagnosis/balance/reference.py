"""Whether another measured torque says what the motor's is worth, and what any channel's gain is.

In J ω̇ + T_f = T_em the motor's torque stands alone: what the model leaves is a part of T_em
itself, so a gain, a saturation or a curve over T_em explains all of it (a regression of T_em on
T_em, biased to nothing by whatever is unknown; Fuller, Measurement Error Models, 1987), and the
force that the model then gives to an unknown load is wrong by as much. Only a load cell or a
torsion bar under load tells it.

A gain multiplies a channel, so its sensitivity is that channel. Under a constant push the motor's
torque is inertia, friction and a constant, and the load cell's a constant and a level: both lie in
what the model's own numbers span, and a refit of those turns any gain into another. The sine of the
angle between is what is left to tell it by (Golub and Van Loan, Matrix Computations, 6.4.3).
"""

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import ALL
from eps_hil.diagnosis.balance.fit import own_column
from eps_hil.diagnosis.balance.problem import Problem

Floats = npt.NDArray[np.float64]

OF_MOTOR = ("motor_torque_gain", "motor_torque_saturation")
"""Effects that only such a reference can show beside something unknown."""
LEAST = 0.1
"""Energy of the measured load beside the motor's, what the model's own numbers can do projected
out of both, from which it is a reference: below, a tenth of what is unknown is a hundredth of T."""

LEAST_SINE = 0.1
"""Of the angle between a gain's sensitivity and what the model's own numbers span: an error of 1 %
in the form of those torques moves the gain by 1 % over the sine, so by a tenth at most."""


def torque_is_referenced(problem: Problem) -> bool:
    """Whether the loads that were measured vary as the motor's torque does, and nothing else."""
    motor, load = [], []
    for one in problem.recordings:
        motion, model = one.as_measured().motion(problem.model), problem.model
        motor.append(one.thin(motion.motor_torque_nm))
        hand = model.sensor_to_rotor * motion.torque_sensor_nm
        load.append(one.thin(hand - motion.rack_force_n / model.rack_to_rotor_ratio_rad_per_m))
    both = np.column_stack([np.concatenate(motor), np.concatenate(load)])
    total, apart = _energies(problem, both / problem.scale[:, None])
    varies = apart[0] > LEAST_SINE**2 * total[0]  # else both are noise by now
    return bool(varies and apart[1] > LEAST * apart[0])


def gain_is_observable(problem: Problem, columns: Floats) -> bool:
    """Whether sensitivities (n, k) to a gain do what no refit of the model's own numbers does."""
    total, apart = _energies(problem, columns)
    return bool(np.all(apart > LEAST_SINE**2 * total))


def _energies(problem: Problem, columns: Floats) -> tuple[Floats, Floats]:
    """Energy (k,) of weighted columns (n, k) while sliding; the same, own numbers projected out."""
    use = problem.sliding
    own = np.column_stack([own_column(problem, name) for name in {**ALL, **problem.tied}])[use]
    size = np.sqrt(np.sum(own**2, axis=0))
    q, r = np.linalg.qr(own[:, size > 0.0] / size[size > 0.0])
    q = q[:, np.abs(np.diag(r)) > 1e-6]
    apart = columns[use] - q @ (q.T @ columns[use])
    return np.sum(columns[use] ** 2, axis=0), np.sum(apart**2, axis=0)
