"""The rig's side of set-points over CAN: check each command, limit every change, stop by itself.

No I/O and no clock of its own. A rig that a program drives must not depend on that program: when
good commands stop for the time-out, speed and preload go to zero at the rig's own rates, and the
robot goes on holding the wheel. That is latched: only a release in so many words lets commands
count again, for a program that was stopped and goes on sends what is long out of date. Which share
of the preload the EPS motor carries is a setting of the rig: a torque of the motor is commanded by
an armed override and by nothing else, so a set-point with a share in it is refused.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.bus.codec import data_id_of
from eps_hil.bus.frame import Frame
from eps_hil.bus.protection import E2E_P01, CrcRule, crc_byte
from eps_hil.bus.signal_codec import no_value_raws
from eps_hil.errors import InputError
from eps_hil.physics.chain import HAND_ANGLE, HAND_DAMPING, HAND_STIFFNESS, LOAD_FORCE
from eps_hil.rig.manoeuvre import COLUMNS, PRELOAD_COMPENSATION

RIG_COMMAND = "RIG_Command"
_ENABLE = 1
_COUNTERS = 256

ROBOT_STIFFNESS_NM_PER_RAD = 400.0
ROBOT_DAMPING_NM_S_PER_RAD = 12.0
ACCELERATION_RAD_S2 = 10.0
"""Of the steering wheel: 2 rad/s are reached in 0.2 s."""
FORCE_RATE_N_PER_S = 4000.0
WHEEL_SPEED_LIMIT_RAD_S = 6.0
FORCE_LIMIT_N = 10_000.0

Floats = npt.NDArray[np.float64]


class CommandState(IntEnum):
    """What the rig makes of its commands."""

    RELEASED = 0
    ACTIVE = 1
    TIMED_OUT = 2
    REJECTED = 3


@dataclass(frozen=True, slots=True)
class SetPoint:
    """A command that passed CRC and length; NaN: not available."""

    counter: int
    enable: bool
    wheel_speed_rad_s: float
    rack_force_n: float
    motor_share: float

    @property
    def within_limits(self) -> bool:
        """Whether all values are there and within what the rig may do."""
        return (
            abs(self.wheel_speed_rad_s) <= WHEEL_SPEED_LIMIT_RAD_S
            and abs(self.rack_force_n) <= FORCE_LIMIT_N
            and self.motor_share == 0.0
        )


class SetPointReader:
    """Decodes and checks command frames by their message in the DBC."""

    def __init__(self, message: Any) -> None:
        self._message = message
        self.can_id = int(message.frame_id)
        byte = crc_byte(message.get_signal_by_name("Crc"))
        if byte is None:
            raise InputError("DBC", f"{RIG_COMMAND}.Crc", "is not one whole byte")
        self._crc = CrcRule.make(byte, E2E_P01, data_id_of(message))

    def read(self, frame: Frame) -> SetPoint | None:
        """The command, or None where CRC or length is wrong."""
        if len(frame.data) != self._message.length or not self._crc.good(frame.data):
            return None
        raw = self._message.decode(frame.data, decode_choices=False, scaling=False)
        return SetPoint(
            int(raw["Counter"]),
            int(raw["CommandRequest"]) == _ENABLE,
            self._value("WheelSpeedSetPoint", raw),
            self._value("RackForceSetPoint", raw),
            self._value("MotorShare", raw) / 100.0,
        )

    def _value(self, name: str, raw: dict[str, float]) -> float:
        signal = self._message.get_signal_by_name(name)
        value = float(raw[name]) * float(signal.scale) + float(signal.offset)
        low = -math.inf if signal.minimum is None else signal.minimum
        high = math.inf if signal.maximum is None else signal.maximum
        none = raw[name] in no_value_raws(signal)
        return value if not none and low <= value <= high else math.nan


class RigControl:
    """Set-points as the rig follows them, ``step_s`` per :meth:`rows`; times in ns.

    ``motor_share``: of the preload, carried by the EPS motor.
    """

    def __init__(self, timeout_ns: int, motor_share: float = 1.0, step_s: float = 1e-3) -> None:
        self._timeout_ns, self._share, self._step_s = timeout_ns, motor_share, step_s
        self._heard_ns = 0
        self._counter: int | None = None
        self._wanted = SetPoint(0, False, 0.0, 0.0, 0.0)
        self._speed_rad_s = self._angle_rad = self._force_n = 0.0
        self._rows = np.zeros((2, COLUMNS))
        self.state = CommandState.RELEASED
        self.timeouts = 0

    def hear(self, command: SetPoint | None, now_ns: int, wheel_angle_rad: float) -> None:
        """One command frame arrived (None: CRC or length is wrong), the wheel being where it is.

        A damaged or repeated frame is no sign of life. A command beyond the rig's limits stops it.
        After a time-out nothing counts but a release.
        """
        if command is None:
            return
        if self.state is not CommandState.RELEASED and command.counter == self._counter:
            return
        self._counter, self._heard_ns = command.counter, now_ns
        if not command.enable:
            self.state = CommandState.RELEASED
            return
        if self.state is CommandState.TIMED_OUT:
            return
        if self.state is CommandState.RELEASED:
            self._angle_rad, self._speed_rad_s, self._force_n = wheel_angle_rad, 0.0, 0.0
        self.state = CommandState.ACTIVE if command.within_limits else CommandState.REJECTED
        self._wanted = command

    def rows(self, now_ns: int) -> Floats | None:
        """Set-point rows of this step and the next, (2, COLUMNS); None: not commanded."""
        if self.state is CommandState.RELEASED:
            return None
        commanded = self.state in {CommandState.ACTIVE, CommandState.REJECTED}
        if commanded and now_ns - self._heard_ns > self._timeout_ns:
            self.state = CommandState.TIMED_OUT
            self.timeouts += 1
        going = self.state is CommandState.ACTIVE
        self._fill(self._rows[0])
        before = self._speed_rad_s
        speed = self._wanted.wheel_speed_rad_s if going else 0.0
        force = self._wanted.rack_force_n if going else 0.0
        self._speed_rad_s = _towards(before, speed, ACCELERATION_RAD_S2 * self._step_s)
        self._force_n = _towards(self._force_n, force, FORCE_RATE_N_PER_S * self._step_s)
        self._angle_rad += 0.5 * (before + self._speed_rad_s) * self._step_s
        self._fill(self._rows[1])
        return self._rows

    def _fill(self, row: Floats) -> None:
        row[:] = 0.0
        row[HAND_STIFFNESS] = ROBOT_STIFFNESS_NM_PER_RAD
        row[HAND_DAMPING] = ROBOT_DAMPING_NM_S_PER_RAD
        row[HAND_ANGLE] = self._angle_rad
        row[LOAD_FORCE] = self._force_n
        row[PRELOAD_COMPENSATION] = self._share


def _towards(value: float, target: float, most: float) -> float:
    return value + min(max(target - value, -most), most)
