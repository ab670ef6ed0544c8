"""The canonical signals (CONTRACT 2): every file, mapping and estimator uses these names.

Sign and side (CONTRACT 1): torques and angles are at the motor rotor unless the name says
otherwise; positive motor torque, torque-sensor torque and speed turn the same way; a positive
rack force opposes them.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Signal:
    """One physical quantity under its canonical name; the unit is SI and ends the name."""

    name: str
    unit: str
    description: str


TIME = "time_s"

_ALL = (
    Signal("motor_torque_nm", "Nm", "torque that the ECU reports"),
    Signal("torque_sensor_nm", "Nm", "torsion-bar torque, at the column"),
    Signal("motor_speed_rad_s", "rad/s", "rotor speed"),
    Signal("motor_angle_rad", "rad", "rotor angle, unwrapped"),
    Signal("rack_force_n", "N", "rig load cell (sum of both tie rods)"),
    Signal("rack_position_m", "m", "rack position of the rig"),
    Signal("steering_wheel_angle_rad", "rad", "steering-wheel angle"),
    Signal("steering_wheel_speed_rad_s", "rad/s", "steering-wheel speed"),
    Signal("motor_temperature_degc", "degC", "motor temperature"),
    Signal("vehicle_speed_m_s", "m/s", "vehicle speed"),
    Signal("lateral_acceleration_m_s2", "m/s^2", "lateral acceleration"),
    Signal("yaw_rate_rad_s", "rad/s", "yaw rate"),
    Signal("rack_force_estimate_n", "N", "published rack-force estimate"),
    Signal("friction_torque_nm", "Nm", "output of the friction model"),
)

CANONICAL: dict[str, Signal] = {signal.name: signal for signal in _ALL}

PUBLISHED = ("rack_force_estimate_n", "friction_torque_nm")
"""What we put on the bus ourselves: no measurement, and there before and after the rig is."""

ESTIMATOR_INPUTS = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
"""What the estimator reads, in the order of its input vector."""
