"""Whether another measured torque says what the motor's is worth.

In J ω̇ + T_f = T_em the motor's torque stands alone: what the model leaves is a part of T_em
itself, so a gain, a saturation or a curve over T_em explains all of it (a regression of T_em on
T_em, biased to nothing by whatever is unknown; Fuller, Measurement Error Models, 1987), and the
force that the model then gives to an unknown load is wrong by as much. Only a load cell or a
torsion bar under load tells it.
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


def torque_is_referenced(problem: Problem) -> bool:
    """Whether the loads that were measured vary as the motor's torque does, and nothing else."""
    motor, load = [], []
    for one in problem.recordings:
        motion, model = one.motion(problem.model), problem.model
        motor.append(one.thin(motion.motor_torque_nm))
        hand = model.sensor_to_rotor * motion.torque_sensor_nm
        load.append(one.thin(hand - motion.rack_force_n / model.rack_to_rotor_ratio_rad_per_m))
    use = problem.sliding
    both = np.column_stack([np.concatenate(motor), np.concatenate(load)])[use]
    own = np.column_stack([own_column(problem, name) for name in {**ALL, **problem.tied}])
    own = (own * problem.scale[:, None])[use]
    size = np.sqrt(np.sum(own**2, axis=0))
    q, r = np.linalg.qr(own[:, size > 0.0] / size[size > 0.0])
    q = q[:, np.abs(np.diag(r)) > 1e-6]
    energy = np.sum((both - q @ (q.T @ both)) ** 2, axis=0)
    return bool(energy[1] > LEAST * energy[0])
