"""The simulated ECU's side of the torque override: check each command, and let go by itself.

No I/O and no clock of its own. What a real ECU must do is here: CRC and counter are checked, and
when good commands stop for ``timeout`` the motor torque goes to zero and stays there (latched)
until the override is released in so many words: commands alone, of a process that was stopped and
goes on, say, bring no torque back.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from eps_hil.bus.codec import data_id_of
from eps_hil.bus.frame import Frame
from eps_hil.bus.protection import E2E_P01, CrcRule, crc_byte
from eps_hil.bus.signal_codec import no_value_raws
from eps_hil.errors import InputError

COMMAND = "EPSHIL_TorqueOverride"
STATUS = "EPS_OverrideStatus"
_ENABLE = 1
_COUNTERS = 256


class OverrideState(IntEnum):
    """Signal ``OverrideState`` of the DBC."""

    RELEASED = 0
    ACTIVE = 1
    TIMED_OUT = 2
    REJECTED = 3


class OverrideReason(IntEnum):
    """Signal ``OverrideReason`` of the DBC; the first refusals that this ECU knows."""

    NONE = 0
    COMMAND_TIMEOUT = 1
    CRC_ERROR = 2
    COUNTER_ERROR = 3
    TORQUE_RANGE = 4


@dataclass(frozen=True, slots=True)
class Command:
    """A torque override command that passed its checks."""

    counter: int
    enable: bool
    torque_nm: float  # NaN: not available


class CommandReader:
    """Decodes and checks command frames by their message in the DBC."""

    def __init__(self, message: Any) -> None:
        self._message = message
        self.can_id = int(message.frame_id)
        byte = crc_byte(message.get_signal_by_name("Crc"))
        if byte is None:
            raise InputError("DBC", f"{COMMAND}.Crc", "is not one whole byte")
        self._crc = CrcRule.make(byte, E2E_P01, data_id_of(message))
        torque = message.get_signal_by_name("RequestedMotorTorque")
        self._absent = no_value_raws(torque)
        self._scale, self._offset = float(torque.scale), float(torque.offset)

    def read(self, frame: Frame) -> Command | None:
        """The command, or None where CRC or length is wrong."""
        if len(frame.data) != self._message.length or not self._crc.good(frame.data):
            return None
        raw = self._message.decode(frame.data, decode_choices=False, scaling=False)
        request, torque = int(raw["OverrideRequest"]), raw["RequestedMotorTorque"]
        value = math.nan if torque in self._absent else torque * self._scale + self._offset
        return Command(int(raw["Counter"]), request == _ENABLE, value)


class Override:
    """Torque override as the ECU sees it; times in ns of any steady clock."""

    def __init__(self, timeout_ns: int, torque_limit_nm: float) -> None:
        self._timeout_ns, self._limit_nm = timeout_ns, torque_limit_nm
        self._heard_ns = 0
        self._counter: int | None = None
        self._torque_nm = 0.0
        self.state = OverrideState.RELEASED
        self.reason = OverrideReason.NONE
        self.timeouts = 0

    def hear(self, command: Command | None, now_ns: int) -> None:
        """One command frame arrived; None: it failed its CRC or length.

        A frame that fails a check changes nothing but the reason, so a stream of bad frames ends
        in the time-out. After a time-out the counter may start anywhere.
        """
        if command is None:
            self.reason = OverrideReason.CRC_ERROR
            return
        fresh = self._counter is None or self.state is OverrideState.TIMED_OUT
        step = 1 if fresh else (command.counter - (self._counter or 0)) % _COUNTERS
        self._counter = command.counter
        if step == 0:
            self.reason = OverrideReason.COUNTER_ERROR
            return
        self._heard_ns = now_ns
        if not command.enable:
            self.state, self.reason = OverrideState.RELEASED, OverrideReason.NONE
        elif self.state is OverrideState.TIMED_OUT:
            self.reason = OverrideReason.COMMAND_TIMEOUT
        elif not abs(command.torque_nm) <= self._limit_nm:  # also NaN
            self.state, self.reason = OverrideState.REJECTED, OverrideReason.TORQUE_RANGE
        else:
            self.state, self.reason = OverrideState.ACTIVE, OverrideReason.NONE
            self._torque_nm = command.torque_nm

    def torque_nm(self, now_ns: int) -> float | None:
        """Torque in place of the ECU's own; None: own control. Call every millisecond."""
        engaged = self.state in {OverrideState.ACTIVE, OverrideState.REJECTED}
        if engaged and now_ns - self._heard_ns > self._timeout_ns:
            self.state, self.reason = OverrideState.TIMED_OUT, OverrideReason.COMMAND_TIMEOUT
            self.timeouts = min(self.timeouts + 1, 255)
        if self.state is OverrideState.RELEASED:
            return None
        return self._torque_nm if self.state is OverrideState.ACTIVE else 0.0

    def status(self, applied_nm: float) -> dict[str, float]:
        """Values of the status message, in DBC units."""
        return {
            "AppliedMotorTorque": applied_nm,
            "OverrideState": float(self.state),
            "OverrideReason": float(self.reason),
            "CommandCounterEcho": float(self._counter or 0),
            "TimeoutCount": float(self.timeouts),
        }
