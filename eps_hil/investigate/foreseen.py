"""What an experiment would record: the robot-held rig simulated, without a bus or a clock."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.investigate.experiment import TICK_S, Experiment, start_m
from eps_hil.physics.chain import HAND_ANGLE, HAND_DAMPING, HAND_STIFFNESS, LOAD_FORCE
from eps_hil.physics.chain_parameters import ChainParameters
from eps_hil.physics.model import Model
from eps_hil.programme.limits import Limits
from eps_hil.rig.assumed_chain import assumed_chain
from eps_hil.rig.command import ROBOT_DAMPING_NM_S_PER_RAD, ROBOT_STIFFNESS_NM_PER_RAD
from eps_hil.rig.manoeuvre import COLUMNS, PRELOAD_COMPENSATION, ROWS_PER_S
from eps_hil.rig.plant import Plant
from eps_hil.rig.sensors import REPORTED, Sensors, SensorSettings
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]
_MASSES = 2
_APPROACH_S = 0.5


@dataclass(frozen=True)
class Foreseen:
    """Simulated signals, and the largest torques in them."""

    series: Mapping[str, Series]
    sensor_nm: float
    motor_nm: float

    def within(self, limits: Limits) -> bool:
        """Whether it stays below the torques that the rig's limits allow."""
        sensor, motor = limits.sensor_torque_nm, limits.motor_torque_nm
        return self.sensor_nm <= sensor and self.motor_nm <= motor


def foresee(
    model: Model,
    experiment: Experiment,
    limits: Limits,
    motor_share: float,
    chain: ChainParameters | None = None,
) -> Foreseen:
    """One run of the experiment through a chain of two masses and its sensors."""
    parameters = assumed_chain(model, chain)
    table, lead = _table(experiment, limits, model, motor_share)
    truth = Plant(model, parameters, _MASSES, table).run()
    reported = Sensors(model, SensorSettings(), 0).run(truth)[lead:]
    t_ns = np.arange(len(reported), dtype=np.int64) * (1_000_000_000 // ROWS_PER_S)
    named = zip(REPORTED, reported.T, strict=True)
    series = {name: Series(t_ns, values.copy()) for name, values in named}
    most = {name: float(np.max(np.abs(series[name].value))) for name in _TORQUES}
    return Foreseen(series, most["torque_sensor_nm"], most["motor_torque_nm"])


_TORQUES = ("torque_sensor_nm", "motor_torque_nm")


def _table(
    experiment: Experiment, limits: Limits, model: Model, motor_share: float
) -> tuple[Floats, int]:
    """Set-point rows at 1 kHz of a robot that follows the course; rows of the way to its start."""
    speed, load = experiment.course(limits)
    way_rad = start_m(experiment, limits, model) * model.rack_to_rotor_ratio_rad_per_m
    ticks = 1 + round((_APPROACH_S + abs(way_rad) / limits.speed_rad_s) / TICK_S)
    there = way_rad / (ticks * TICK_S) * (1.0 - np.cos(2.0 * np.pi * np.arange(ticks) / ticks))
    still = np.zeros(round(_APPROACH_S / TICK_S))
    lead = len(there) + len(still)
    speed = np.concatenate([there, still, speed])
    load = np.concatenate([np.zeros(lead), load])
    coarse = TICK_S * np.arange(len(speed))
    time_s = np.arange(round(len(speed) * TICK_S * ROWS_PER_S) + 1) / ROWS_PER_S
    wheel = np.interp(time_s, coarse, speed) * model.sensor_to_rotor
    table = np.zeros((len(time_s), COLUMNS))
    table[:, HAND_STIFFNESS] = ROBOT_STIFFNESS_NM_PER_RAD
    table[:, HAND_DAMPING] = ROBOT_DAMPING_NM_S_PER_RAD
    table[1:, HAND_ANGLE] = np.cumsum(0.5 * (wheel[1:] + wheel[:-1])) / ROWS_PER_S
    table[:, LOAD_FORCE] = np.interp(time_s, coarse, load)
    table[:, PRELOAD_COMPENSATION] = motor_share
    return table, round(lead * TICK_S * ROWS_PER_S)
