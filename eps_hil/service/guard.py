"""The torque guard: what stands between every torque request and the bus (DESIGN.md, 7).

Pure: no I/O, no clock, no logging; times come in as integer nanoseconds of one steady clock.
It either lets a request through unchanged or trips. A trip means zero torque and release, is
latched with its reasons, and only the operator gets out of it: :meth:`TorqueGuard.clear`, then
both steps of arming again. It never clips: whoever asks for too much is not in control.
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import IntFlag

from eps_hil.estimation.validity import Reason
from eps_hil.service.limits import Limits

WINDOW_NS = 250_000_000
ARM_PAUSE_NS = 200_000_000
"""The steps of arming lie at least this far apart: one bouncing key is not two decisions."""
ECU_ACTIVE = 1
"""``OverrideState`` of the ECU's status message when it applies the command."""


class Trip(IntFlag):
    """Why the guard tripped; ``TripReason`` of the DBC's ``EPSHIL_OverrideState`` in this order."""

    NONE = 0
    NOT_FINITE = 1
    """The request, or an input, is no number."""
    TORQUE = 2
    """The request is beyond ``max_torque_nm``."""
    STEP = 4
    """The request changes by more than ``max_step_nm`` from one frame to the next."""
    CHANGE_250MS = 8
    """The request differs too much from a command of the last 250 ms."""
    DRIVER = 16
    """Torsion-bar torque beyond ``max_driver_torque_nm``: a hand is in the wheel."""
    TORQUE_ERROR = 32
    """The ECU reports a torque that was not commanded."""
    ECU_STATUS = 64
    """The ECU does not say that it applies the command."""
    SPEED = 128
    """Rotor speed beyond ``max_motor_speed_rad_s``."""
    POSITION = 256
    """Rack outside its window."""
    ENERGY = 512
    """``max_energy_j`` is spent."""
    TIME_BUDGET = 1024
    """Armed for longer than ``max_armed_s``."""
    HEARTBEAT = 2048
    """No sign of life from the operator."""
    OTHER_TRANSMITTER = 4096
    """Somebody else sends the command's id."""
    STALE_INPUT = 8192
    """An input is missing or too old."""
    INVALID_INPUT = 16384
    """The service's verdict over the inputs is not "fine" (``reason`` says why)."""
    FROZEN_INPUT = 32768
    """An input has not changed a bit for too long."""
    BUS = 65536
    """Bus error, a full send queue, or the bus is gone."""
    CLOCK = 131072
    """Time ran backwards, or no decision was made for ``max_frame_gap_s`` (a stopped process)."""
    OPERATOR = 262144
    """The operator, or the end of the program, stopped it."""


@dataclass(frozen=True, slots=True)
class Reading:
    """A value and when it was received, on the guard's clock."""

    value: float
    t_ns: int


@dataclass(frozen=True, slots=True)
class Seen:
    """What is known when a request is judged.

    ``motor_torque_nm``: as the ECU reports it; ``ecu_state``: of its status message (None: it has
    none); ``reason``: the service's verdict over its inputs; ``foreign``: the command's id was
    seen from somebody else; ``bus_good``: no error, no refused frame, not lost.
    """

    motor_torque_nm: Reading
    torque_sensor_nm: Reading
    motor_speed_rad_s: Reading
    rack_position_m: Reading
    ecu_state: Reading | None
    reason: Reason
    foreign: bool
    bus_good: bool

    @property
    def inputs(self) -> tuple[Reading, Reading, Reading, Reading]:
        """The readings that every command rests on."""
        return (
            self.motor_torque_nm,
            self.torque_sensor_nm,
            self.motor_speed_rad_s,
            self.rack_position_m,
        )


@dataclass(frozen=True, slots=True)
class Command:
    """What may go onto the bus: ``torque_nm`` (rotor) counts only while ``enable``."""

    torque_nm: float
    enable: bool


class TorqueGuard:
    """Judges one request a call; see :class:`~eps_hil.service.limits.Limits` for the limits."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.trips = Trip.NONE
        """Reasons of the latched trip."""
        self.reason = Reason.FINE
        """The verdict over the inputs at the trip."""
        self.armed = False
        self.energy_j = 0.0
        self._frozen_s = (
            limits.motor_torque_frozen_s,
            limits.torque_sensor_frozen_s,
            limits.motor_speed_frozen_s,
            limits.rack_position_frozen_s,
        )
        self._values = [math.nan] * 4
        self._changed_ns = [0] * 4
        self._prepared_ns: int | None = None
        self._armed_ns = self._beat_ns = 0
        self._last_ns: int | None = None
        self._enabled_ns: int | None = None
        self._unjudged_ns = self._unconfirmed_ns = 0
        self._torque_nm = 0.0
        self._history: deque[tuple[int, float]] = deque()

    # The operator.

    def prepare(self, now_ns: int) -> bool:
        """First step of arming; False while latched or armed."""
        if self.trips or self.armed:
            return False
        self._prepared_ns = now_ns
        return True

    def arm(self, now_ns: int, seen: Seen) -> bool:
        """Second step: within ``arm_window_s`` of the first, with good inputs; else start anew."""
        prepared_ns, self._prepared_ns = self._prepared_ns, None
        if prepared_ns is None or self.trips:
            return False
        if not ARM_PAUSE_NS <= now_ns - prepared_ns <= _ns(self.limits.arm_window_s):
            return False
        if self.obstacles(now_ns, seen):
            return False
        self.armed = True
        self.energy_j = 0.0
        self._unjudged_ns = self._unconfirmed_ns = 0
        self._armed_ns = self._beat_ns = now_ns
        return True

    def heartbeat(self, now_ns: int) -> None:
        """The operator is there and wants it."""
        self._beat_ns = now_ns

    def disarm(self) -> None:
        """Back to unarmed; a latched trip stays."""
        self.armed = False
        self._prepared_ns = None

    def trip(self, trips: Trip, reason: Reason = Reason.FINE) -> None:
        """Latch (the first trip's reasons stay) and disarm."""
        if not self.trips:
            self.trips, self.reason = trips, reason
        self.disarm()

    def clear(self) -> None:
        """The operator has seen why; arming starts from its first step."""
        self.trips, self.reason = Trip.NONE, Reason.FINE
        self.disarm()

    # Every frame.

    def step(self, now_ns: int, request_nm: float | None, seen: Seen) -> Command:
        """The command for this frame; ``request_nm`` None: nothing is wanted, release."""
        self._watch(now_ns, seen)
        if self.armed:
            found = self.obstacles(now_ns, seen) | self._budget(now_ns)
            if request_nm is not None:
                found |= self._demand(now_ns, request_nm) | self._motion(now_ns, seen)
            if found:
                self.trip(found, seen.reason)
        self._last_ns = now_ns
        if request_nm is None or not self.armed:
            self._torque_nm = 0.0
            self._enabled_ns = None
        else:
            self._torque_nm = request_nm
            if self._enabled_ns is None:
                self._enabled_ns = now_ns
        self._history.append((now_ns, self._torque_nm))
        return Command(self._torque_nm, self._enabled_ns is not None)

    def _watch(self, now_ns: int, seen: Seen) -> None:
        """Since when each input has its value, what was done, and which commands still count."""
        for place, reading in enumerate(seen.inputs):
            if reading.value != self._values[place]:
                self._values[place], self._changed_ns[place] = reading.value, now_ns
        if self._last_ns is not None:
            power_w = abs(self._torque_nm * seen.motor_speed_rad_s.value)
            self.energy_j += power_w * (now_ns - self._last_ns) * 1e-9
            if self._enabled_ns is not None:
                self._watch_ecu(now_ns, self._last_ns, self._enabled_ns, seen)
        while self._history and now_ns - self._history[0][0] > WINDOW_NS:
            self._history.popleft()

    def _watch_ecu(self, now_ns: int, last_ns: int, enabled_ns: int, seen: Seen) -> None:
        """For how long the ECU had a command that it was not judged by, or did not confirm.

        Releases in between do not start this anew, or one that refuses short commands is never
        noticed. It ends with a command long enough to be judged, and with an "active" during one.
        """
        judged = last_ns - enabled_ns > _ns(self.limits.torque_response_s)
        self._unjudged_ns = 0 if judged else self._unjudged_ns + now_ns - last_ns
        state = seen.ecu_state
        confirmed = state is not None and state.t_ns > enabled_ns and self._active(now_ns, state)
        self._unconfirmed_ns = 0 if confirmed else self._unconfirmed_ns + now_ns - last_ns

    def _active(self, now_ns: int, state: Reading) -> bool:
        """Whether the ECU says that it applies the command."""
        fresh = _fresh(now_ns, state.t_ns, self.limits.ecu_status_timeout_s)
        return fresh and state.value == ECU_ACTIVE

    def obstacles(self, now_ns: int, seen: Seen) -> Trip:
        """Inputs, bus and clock: what stands against arming, or ends it."""
        limits, found = self.limits, Trip.NONE
        if self._last_ns is None or not _fresh(now_ns, self._last_ns, limits.max_frame_gap_s):
            found |= Trip.CLOCK
        if not all(_fresh(now_ns, each.t_ns, limits.max_input_age_s) for each in seen.inputs):
            found |= Trip.STALE_INPUT
        if not all(math.isfinite(each.value) for each in seen.inputs):
            found |= Trip.NOT_FINITE
        for since_ns, frozen_s in zip(self._changed_ns, self._frozen_s, strict=True):
            if frozen_s is not None and not _fresh(now_ns, since_ns, frozen_s):
                found |= Trip.FROZEN_INPUT
        if seen.reason:
            found |= Trip.INVALID_INPUT
        if seen.foreign:
            found |= Trip.OTHER_TRANSMITTER
        if not seen.bus_good:
            found |= Trip.BUS
        return found

    def _budget(self, now_ns: int) -> Trip:
        found = Trip.NONE
        if not self.energy_j <= self.limits.max_energy_j:
            found |= Trip.ENERGY
        if not _fresh(now_ns, self._armed_ns, self.limits.max_armed_s):
            found |= Trip.TIME_BUDGET
        return found

    def _demand(self, now_ns: int, request_nm: float) -> Trip:
        """The request itself. Zero is always allowed, however fast it comes."""
        limits, found = self.limits, Trip.NONE
        if not _fresh(now_ns, self._beat_ns, limits.heartbeat_timeout_s):
            found |= Trip.HEARTBEAT
        if not math.isfinite(request_nm):
            return found | Trip.NOT_FINITE
        if request_nm == 0.0:
            return found
        if abs(request_nm) > limits.max_torque_nm:
            found |= Trip.TORQUE
        if abs(request_nm - self._torque_nm) > limits.max_step_nm:
            found |= Trip.STEP
        furthest = limits.max_change_250ms_nm
        if any(abs(request_nm - past_nm) > furthest for _, past_nm in self._history):
            found |= Trip.CHANGE_250MS
        return found

    def _motion(self, now_ns: int, seen: Seen) -> Trip:
        """Driver, gear and ECU while a torque is wanted."""
        limits, found = self.limits, Trip.NONE
        if abs(seen.torque_sensor_nm.value) > limits.max_driver_torque_nm:
            found |= Trip.DRIVER
        if abs(seen.motor_speed_rad_s.value) > limits.max_motor_speed_rad_s:
            found |= Trip.SPEED
        position_m = seen.rack_position_m.value
        if not limits.rack_position_min_m <= position_m <= limits.rack_position_max_m:
            found |= Trip.POSITION
        enabled_for_ns = 0 if self._enabled_ns is None else now_ns - self._enabled_ns
        return found | self._ecu(now_ns, enabled_for_ns, seen)

    def _ecu(self, now_ns: int, enabled_for_ns: int, seen: Seen) -> Trip:
        """Whether the ECU does, and says that it does, what it was told a moment ago."""
        limits, found = self.limits, Trip.NONE
        response_ns, status_ns = _ns(limits.torque_response_s), _ns(limits.ecu_status_timeout_s)
        if enabled_for_ns > response_ns or self._unjudged_ns > response_ns:
            told = [nm for t_ns, nm in self._history if now_ns - t_ns <= response_ns]
            told.append(self._torque_nm)  # in force, however long ago it was sent
            reported_nm, slack_nm = seen.motor_torque_nm.value, limits.max_torque_error_nm
            if not min(told) - slack_nm <= reported_nm <= max(told) + slack_nm:
                found |= Trip.TORQUE_ERROR
        state = seen.ecu_state
        if state is not None:
            late = enabled_for_ns > status_ns and not self._active(now_ns, state)
            if late or self._unconfirmed_ns > status_ns:
                found |= Trip.ECU_STATUS
        return found


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)


def _fresh(now_ns: int, then_ns: int, limit_s: float) -> bool:
    """Whether ``then`` is not in the future and not longer ago than ``limit_s``."""
    return 0 <= now_ns - then_ns <= _ns(limit_s)
