"""Limits of the torque override: the ``override.limits`` block, within ceilings that no file moves.

Torques are at the motor rotor, the torsion-bar torque at the column. The reference gear turns
1 Nm at the rotor into 20 Nm at the steering wheel (i_APA/i_pi), which is why the ceilings are
low. None of the limits has a default: what nobody stated, nobody thought about.
"""

import math
from dataclasses import dataclass, fields
from typing import Annotated

from pydantic import ConfigDict, Field, with_config

CEILINGS = {
    "max_torque_nm": 1.0,
    "max_step_nm": 0.05,
    "max_change_250ms_nm": 0.5,
    "max_driver_torque_nm": 5.0,
    "max_torque_error_nm": 0.3,
    "torque_response_s": 0.05,
    "ecu_status_timeout_s": 0.2,
    "max_motor_speed_rad_s": 60.0,
    "rack_position_min_m": 0.06,
    "rack_position_max_m": 0.06,
    "max_energy_j": 50.0,
    "max_armed_s": 600.0,
    "arm_window_s": 30.0,
    "heartbeat_timeout_s": 1.0,
    "max_input_age_s": 0.1,
    "max_frame_gap_s": 0.05,
    "motor_torque_frozen_s": 1.0,
    "torque_sensor_frozen_s": 1.0,
    "motor_speed_frozen_s": 1.0,
    "rack_position_frozen_s": 1.0,
}
"""The largest magnitude that each limit may have, in the unit of its name."""


def _below(name: str) -> object:
    return Field(strict=True, gt=0, le=CEILINGS[name])


def _within(name: str) -> object:
    return Field(strict=True, ge=-CEILINGS[name], le=CEILINGS[name])


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What the torque guard enforces; every field has to be given, the unit is in its name.

    ``max_torque_nm``: magnitude of the command; ``max_step_nm``: change from one frame to the
    next; ``max_change_250ms_nm``: between any two commands of 250 ms. ``max_driver_torque_nm``:
    magnitude of the torsion-bar torque. ``max_torque_error_nm``: how far the torque that the ECU
    reports may lie outside the range commanded over the last ``torque_response_s``; less than
    ``max_torque_nm``, or an ECU that does nothing is never noticed.
    ``ecu_status_timeout_s``: so long after the first command, and from then on, the ECU must have
    said "active" (only where it has a status message). Both times are enabled ones: commands too
    short for a verdict add up. ``max_motor_speed_rad_s``,
    ``rack_position_min_m``, ``rack_position_max_m``: what the gear may do. ``max_energy_j``
    (integral of abs(torque · speed)) and ``max_armed_s``: budget of one arming.
    ``arm_window_s``: the second step of arming must follow the first within it.
    ``heartbeat_timeout_s``: the operator's sign of life. ``max_input_age_s``: of each input;
    ``max_frame_gap_s``: between two decisions of the guard. ``…_frozen_s``: an input may be bit
    for bit the same for so long (null: as long as it likes, for a sensor that is silent at rest).
    """

    max_torque_nm: Annotated[float, _below("max_torque_nm")]
    max_step_nm: Annotated[float, _below("max_step_nm")]
    max_change_250ms_nm: Annotated[float, _below("max_change_250ms_nm")]
    max_driver_torque_nm: Annotated[float, _below("max_driver_torque_nm")]
    max_torque_error_nm: Annotated[float, _below("max_torque_error_nm")]
    torque_response_s: Annotated[float, _below("torque_response_s")]
    ecu_status_timeout_s: Annotated[float, _below("ecu_status_timeout_s")]
    max_motor_speed_rad_s: Annotated[float, _below("max_motor_speed_rad_s")]
    rack_position_min_m: Annotated[float, _within("rack_position_min_m")]
    rack_position_max_m: Annotated[float, _within("rack_position_max_m")]
    max_energy_j: Annotated[float, _below("max_energy_j")]
    max_armed_s: Annotated[float, _below("max_armed_s")]
    arm_window_s: Annotated[float, _below("arm_window_s")]
    heartbeat_timeout_s: Annotated[float, _below("heartbeat_timeout_s")]
    max_input_age_s: Annotated[float, _below("max_input_age_s")]
    max_frame_gap_s: Annotated[float, _below("max_frame_gap_s")]
    motor_torque_frozen_s: Annotated[float, _below("motor_torque_frozen_s")] | None
    torque_sensor_frozen_s: Annotated[float, _below("torque_sensor_frozen_s")] | None
    motor_speed_frozen_s: Annotated[float, _below("motor_speed_frozen_s")] | None
    rack_position_frozen_s: Annotated[float, _below("rack_position_frozen_s")] | None

    def __post_init__(self) -> None:
        """The ceilings again, for limits that were not read from a file; ValueError by field."""
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None and field.name.endswith("_frozen_s"):
                continue
            ceiling = CEILINGS[field.name]
            signed = field.name.startswith("rack_position_m")
            low = -ceiling if signed else math.ulp(0.0)
            if not low <= value <= ceiling:
                raise ValueError(f"{field.name} {value} is beyond its ceiling {ceiling}")
        if not self.rack_position_min_m < self.rack_position_max_m:
            raise ValueError("rack_position_min_m is not below rack_position_max_m")
        if not self.max_torque_error_nm < self.max_torque_nm:
            problem = f"max_torque_error_nm {self.max_torque_error_nm} is not below max_torque_nm"
            raise ValueError(f"{problem} {self.max_torque_nm}: no missing torque would be noticed")
