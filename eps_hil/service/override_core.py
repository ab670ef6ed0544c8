"""The heart of an override session without I/O and without a clock: frames in, frames out.

Once for each sync frame: decode, let the source say what it wants, let the guard judge, answer
with one command frame. Whoever owns the bus sends what is returned, one frame at a time, and tells
what became of it. The same object runs live and in lock-step fault injection.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

from eps_hil.bus.codec import Sample
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState
from eps_hil.estimation.validity import Reason, of_inputs
from eps_hil.service.core import ServiceCore
from eps_hil.service.guard import ECU_ACTIVE, Command, Reading, Seen, Trip
from eps_hil.service.latest import LatestValues
from eps_hil.service.override import Override, State
from eps_hil.service.override_setup import OverrideParts

RELEASES = 10
"""Release frames after a torque or an arming ends, for one may be lost; and before a first torque,
because an ECU that timed out once obeys again only after a release. One that the send queue refused
is none of them."""
_STATE_PERIOD_NS = 10_000_000
_SILENCE_NS = 3_000_000
_GOOD_STATES = frozenset({BusState.UNKNOWN, BusState.ERROR_ACTIVE})
_INPUTS = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "rack_position_m")
_LIVE = frozenset({State.ARMED, State.INJECTING})
_RELEASE = Command(0.0, False)


class Source(Protocol):
    """Who wants a torque."""

    def step(
        self, t_ns: int, values: Mapping[str, float], *, engaged: bool, now_ns: int
    ) -> float | None:
        """Wanted torque (Nm, rotor) at a sync frame; None: none, release.

        ``values``: the newest of each canonical signal. ``engaged``: armed and the operator there;
        without it nothing that is wanted reaches the bus. ``now_ns``: the session's steady clock,
        which goes on where sample time stands still.
        """


class _Tee:
    """The decoder, with an ear on what it yields."""

    def __init__(self, parts: OverrideParts, hear: "OverrideCore") -> None:
        self._decoder, self._core = parts.decoder, hear

    def decode(self, frame: Frame) -> list[Sample]:
        samples = self._decoder.decode(frame)
        self._core.take(frame, samples)
        return samples

    @property
    def moved_ns(self) -> int:
        return self._decoder.moved_ns

    def sync(self, frame: Frame) -> bool:
        return self._decoder.sync(frame)


class OverrideCore:
    """One session; times in ns of a steady clock (``now``) and of the frames' stamps (``wall``).

    ``dry_run``: everything is watched and judged, nothing is ever returned to be sent.
    """

    def __init__(self, parts: OverrideParts, source: Source, *, dry_run: bool = False) -> None:
        self.override = Override(parts.override.limits)
        self.values: dict[str, float] = {}
        """The newest value of each signal; NaN for one that went silent."""
        self.command = _RELEASE
        """What was last allowed."""
        self.dropped = 0
        self._parts, self._source, self._dry_run = parts, source, dry_run
        self._latest = LatestValues(parts.decoder.period_s)
        send_ids = frozenset(
            (each.can_id, each.extended) for each in (parts.command, parts.state) if each
        )
        self._service = ServiceCore(_Tee(parts, self), parts.estimator, None, send_ids)
        nothing = Reading(0.0, -(10**18))
        self._readings = dict.fromkeys(_INPUTS, nothing)
        self._ecu: Reading | None = None if parts.status is None else nothing
        self._now_ns = self._wall_ns = 0
        self._last_tick_ns = self._next_state_ns = 0
        self._request_nm: float | None = None
        self._syncs = self._foreign = self._owed = self._armed_ticks = 0
        self._trouble = self._beaten = False

    @property
    def state(self) -> State:
        """Where the session stands."""
        return self.override.state

    @property
    def reason(self) -> Reason:
        """The service's verdict over its inputs; that the friction is unknown yet is none of it,
        for torque injection is how it becomes known.
        """
        latest = self._service.latest
        return Reason.NOT_STARTED if latest is None else of_inputs(latest.reason)

    @property
    def syncs(self) -> int:
        """Sync frames heard."""
        return self._syncs

    @property
    def foreign(self) -> int:
        """Frames of our ids that somebody else sent."""
        return self._service.foreign

    # The operator.

    def prepare(self, now_ns: int) -> bool:
        """First step of arming."""
        return not self._dry_run and self.override.prepare(now_ns)

    def arm(self, now_ns: int) -> bool:
        """Second step of arming."""
        if self.state is State.LISTENING:
            self._beaten, self._armed_ticks = False, 0
        return not self._dry_run and self.override.arm(now_ns, self._seen())

    def heartbeat(self, now_ns: int) -> None:
        """The operator's sign of life."""
        self._beaten = True
        self.override.heartbeat(now_ns)

    # The bus.

    def start(self, now_ns: int) -> None:
        """The bus is open."""
        self.override.listen(now_ns)
        self._last_tick_ns = self._next_state_ns = now_ns

    def on_frames(self, frames: Sequence[Frame], now_ns: int, wall_ns: int) -> list[Frame]:
        """A batch in order; at most one command, that of its newest sync frame."""
        self._now_ns, self._wall_ns = now_ns, wall_ns
        syncs = self._syncs
        for frame in frames:
            self._trouble |= frame.error
            self._hear_ecu(frame)
        self._service.on_frames(frames)
        return self._tick(live=True) if self._syncs > syncs else []

    def on_timer(self, now_ns: int) -> list[Frame]:
        """Every few milliseconds: where sync frames are missing, judge all the same.

        Such a judgement may end a torque; it never sends one.
        """
        if now_ns - self._last_tick_ns < _SILENCE_NS:
            return []
        self._now_ns = now_ns
        return self._tick(live=False)

    def on_sent(self, now_ns: int, frame: Frame, sent: bool) -> None:
        """What became of a frame: a full queue dropped it, or not."""
        command = self._parts.command
        if sent and not self.command.enable and frame.can_id == command.can_id:
            self._owed = max(self._owed - 1, 0)
        if not sent:
            self.dropped += 1
            self.override.trip(now_ns, Trip.BUS, "a frame was refused by a full send queue")

    def on_bus(self, now_ns: int, state: BusState, lost_in_kernel: int = 0) -> None:
        """The controller's state, and frames that the kernel lost."""
        if state not in _GOOD_STATES:
            self.override.trip(now_ns, Trip.BUS, f"the bus is {state.replace('_', ' ')}")
        if lost_in_kernel:
            self.override.trip(now_ns, Trip.BUS, f"{lost_in_kernel} frames lost in the kernel")

    def end(self, now_ns: int, why: str, *, fault: bool = False) -> list[Frame]:
        """The session ends; ``fault``: not of its own accord. The last frames to send."""
        if fault:
            self.override.trip(now_ns, Trip.OPERATOR, why)
        self.override.off(now_ns, why)
        self.command = _RELEASE
        if self._dry_run:
            return []
        return self.owed() + self._told()

    def owed(self, most: int = RELEASES) -> list[Frame]:
        """The releases that the bus has not taken yet, once no torque is wanted any more.

        ``most``: of them; each counts in the message counter, sent or not.
        """
        if self._dry_run or self.command.enable:
            return []
        return [self._parts.command.frame(_RELEASE) for _ in range(min(self._owed, most))]

    def take(self, frame: Frame, samples: Sequence[Sample]) -> None:
        """Samples of a decoded frame (called by the decoder)."""
        received_ns = self._now_ns - (self._wall_ns - frame.t_ns)
        for signal, t_ns, value in samples:
            self._latest.take(signal, t_ns, value)
            if signal in self._readings:
                self._readings[signal] = Reading(value, received_ns)
            elif signal == "motor_angle_rad" and self._parts.position_per_rad:
                position_m = value * self._parts.position_per_rad
                self._readings["rack_position_m"] = Reading(position_m, received_ns)
        if samples and self._parts.decoder.sync(frame):
            self._syncs += 1
            self.values = self._latest.at(samples[0].t_ns)
            engaged = self.state in _LIVE and self._beaten and self._armed_ticks > RELEASES
            wanted = self._source.step(
                samples[0].t_ns, self.values, engaged=engaged, now_ns=self._now_ns
            )
            self._request_nm = wanted if engaged else None

    def _hear_ecu(self, frame: Frame) -> None:
        status = self._parts.status
        if status is None or frame.error or frame.own or frame.remote:
            return
        value = status.read(frame)
        if value is not None:
            obeys = value == self._parts.override.status_active
            received_ns = self._now_ns - (self._wall_ns - frame.t_ns)
            self._ecu = Reading(ECU_ACTIVE if obeys else -1.0, received_ns)

    def _seen(self) -> Seen:
        return Seen(
            **self._readings, ecu_state=self._ecu, reason=self.reason,
            foreign=self._service.foreign > self._foreign, bus_good=not self._trouble,
        )  # fmt: skip

    def _tick(self, *, live: bool) -> list[Frame]:
        now_ns, before = self._now_ns, self.state
        self._last_tick_ns = now_ns
        self.command = self.override.step(now_ns, self._request_nm, self._seen())
        # Judged, and by nothing else: a key pressed between two frames must not hide them
        self._foreign, self._trouble = self._service.foreign, False
        if self._dry_run:
            return []
        frames: list[Frame] = []
        if self.state in _LIVE or before in _LIVE:
            self._owed = RELEASES
            self._armed_ticks += 1
        if self.command.enable:
            frames += [self._parts.command.frame(self.command)] if live else []
        elif self._owed:
            frames.append(self._parts.command.frame(_RELEASE))
        if now_ns >= self._next_state_ns or self.state is not before:
            self._next_state_ns = now_ns + _STATE_PERIOD_NS
            frames += self._told()
        return frames

    def _told(self) -> list[Frame]:
        """The state as a frame, where it is published."""
        if self._parts.state is None:
            return []
        override = self.override
        return [
            self._parts.state.frame(
                {
                    "State": int(override.state),
                    "TripReason": int(override.guard.trips),
                    "Heartbeats": override.heartbeats % 256,
                    "CommandedTorque": self.command.torque_nm,
                }
            )
        ]
