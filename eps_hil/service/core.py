"""The heart of the loop without I/O and without a clock: frames in, the frame to publish out.

The estimates depend on nothing but the frames and their stamps, so a recording replayed as fast as
possible gives them bit for bit (DESIGN.md, decisions 2, 3). How old one is when it is handed to the
bus is told from outside (``now``); without that, its age is that at the sync frame's stamp.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from typing import Protocol

from eps_hil.bus.codec import Sample
from eps_hil.bus.frame import Frame
from eps_hil.estimation.age import AGE_LIMIT_S, AgeDoubt, ShiftDoubt, aged
from eps_hil.estimation.stream import Estimate
from eps_hil.estimation.validity import Reason, bits_on_the_bus
from eps_hil.service.friction_levels import FrictionLevelKeeper

_FOREIGN_HOLD_NS = 1_000_000_000
"""How long after a frame of another transmitter the estimate stays invalid."""

_SETTLING = Reason.SETTLING | Reason.FRICTION_UNKNOWN
_NOT_SETTLING = ~int(_SETTLING)
_STALE = int(Reason.STALE)
_INPUTS = Reason.MOTOR_TORQUE | Reason.TORQUE_SENSOR | Reason.MOTOR_SPEED | Reason.RACK_FORCE
_UNSEEN = int(Reason.NOT_STARTED | _INPUTS | Reason.BAD_SAMPLE | Reason.GAP)

_LOAD_CELL = "rack_force_n"


class Status(IntEnum):
    """``EstimateStatus`` of the DBC."""

    OFF = 0
    SETTLING = 1
    VALID = 2
    INVALID = 3


class Decoder(Protocol):
    """What the core needs of :class:`~eps_hil.bus.codec.FrameDecoder`."""

    def decode(self, frame: Frame) -> list[Sample]:
        """Samples of a frame."""

    @property
    def moved_ns(self) -> int:
        """By how much the sync message's instants moved against its counter, in all."""

    def sync(self, frame: Frame) -> bool:
        """Whether the estimator steps on it."""


class Live(Protocol):
    """What the core needs of :class:`~eps_hil.bus.live_frames.LiveFrames`."""

    names: tuple[str, ...]
    """Signals of the frame that was taken last."""

    def take(self, key: tuple[int, bool], frame: Frame) -> int | None:
        """Put a frame's samples where the estimator's wait; their instant, or None: decode it."""

    def newest(self, signal: str) -> float:
        """The value of one of them."""


class Estimator(Protocol):
    """What the core needs of :class:`~eps_hil.estimation.stream.StreamEstimator`."""

    def push(self, signal: str, t_ns: int, value: float) -> None:
        """Take a sample."""

    def advance(self, t_ns: int) -> int:
        """Step up to a sync stamp; how many estimates are new."""

    def force_of_shift_n(self, shift_ns: int) -> float:
        """By how much the force is off (N) once instants moved."""

    @property
    def latest(self) -> Estimate:
        """The newest estimate."""

    @property
    def latency_s(self) -> float:
        """From a sync frame's stamp back to the instant that its estimate speaks of."""


class Encoder(Protocol):
    """What the core needs of :class:`~eps_hil.bus.codec.FrameEncoder`."""

    def frame(self, values: Mapping[str, float], t_ns: int = 0) -> Frame:
        """The frame that carries the values."""


def status_of(reason: Reason) -> Status:
    """The verdict in one word."""
    bits = int(reason)  # operators of flags take microseconds
    if not bits:
        return Status.VALID
    return Status.INVALID if bits & _NOT_SETTLING else Status.SETTLING


def estimate_values(estimate: Estimate, status: Status, age_s: float) -> dict[str, float]:
    """Signals of ``EPSHIL_Estimate`` (force in N, torque in Nm, age in ms)."""
    return {
        "RackForceEstimate": estimate.rack_force_n,
        "FrictionTorque": estimate.friction_torque_nm,
        "EstimateStatus": int(status),
        "EstimateReason": bits_on_the_bus(int(estimate.reason)),
        "EstimateAge": age_s * 1e3 if age_s >= 0.0 else math.inf,
    }


def silent_values(status: Status, reason: Reason) -> dict[str, float]:
    """Signals of ``EPSHIL_Estimate`` where nothing is being estimated: force not available."""
    return {
        "RackForceEstimate": math.nan,
        "FrictionTorque": math.nan,
        "EstimateStatus": int(status),
        "EstimateReason": int(reason),
        "EstimateAge": math.inf,
    }


class ServiceCore:
    """Decode, step, and say what to publish.

    ``encoder`` None: nothing is ever returned (listen only). ``send_ids``: (id, extended) of
    everything the service sends; such a frame seen from the bus is another transmitter's.
    ``levels``: who looks after the friction levels of ``estimator``, where they may change.
    ``age_limit_s``: see :func:`aged`. ``start_wait_s``: for how long it is settling once it
    has all inputs: what is wrong with a torque since before then shows only where it ends.
    """

    def __init__(
        self,
        decoder: Decoder,
        estimator: Estimator,
        encoder: Encoder | None = None,
        send_ids: frozenset[tuple[int, bool]] = frozenset(),
        levels: FrictionLevelKeeper | None = None,
        age_limit_s: float = AGE_LIMIT_S,
        start_wait_s: float = 0.0,
    ) -> None:
        self.decoder, self.estimator = decoder, estimator
        self.live: Live | None = None
        """What takes usual frames in place of ``decoder``; not with a method that wants them."""
        self.levels = levels
        self._method = None if levels is None else levels.method
        self.steps = self.valid_steps = self.skipped = self.foreign = 0
        self.repeated = 0
        """Sync frames for which no grid point was due: their answer is the one before, older."""
        self.stale = 0
        """Estimates that were too old for their look-back when they were published."""
        self.latest: Estimate | None = None
        """The newest estimate, with the verdict that was published."""
        self.sync_t_ns = 0
        """Receive stamp of the last sync frame."""
        self.load_cell: deque[tuple[int, float]] = deque(maxlen=512)
        """The newest (stamp, rack force of the rig), to show beside the estimate."""
        self.record: list[tuple[int, Estimate]] | None = None
        """Where a list is put here, (sync stamp, estimate) of every new estimate is appended to
        it: of the frames alone, whatever the service's own lateness made of it."""
        self._encoder, self._send_ids = encoder, send_ids
        self._foreign_t_ns: int | None = None
        self._look_back_ns = round(estimator.latency_s * 1e9)
        self._age_limit_ns = round(age_limit_s * 1e9)
        self._doubt = AgeDoubt(self._look_back_ns)
        self._shift = ShiftDoubt(self._look_back_ns, estimator, decoder.moved_ns)
        self._start_wait_ns = round(start_wait_s * 1e9)
        self._started_ns: int | None = None
        """Receive stamp at which all inputs were there for the first time."""

    def on_frames(
        self, frames: Sequence[Frame], now: Callable[[], int] | None = None
    ) -> list[Frame]:
        """Take a batch in order; at most one frame to publish: that of its newest sync frame.

        ``now``: the time (ns) by the clock of the frames' stamps; asked when the whole batch has
        been worked through and the answer is made. The published age and verdict are of that
        time: what waited is not valid. Without it they are of the sync frame's stamp.

        A batch holds several sync frames only when the loop was late. Stale estimates are not
        sent in a burst: they are left out, counted in ``skipped``, and seen by the receiver as
        a jump of the message counter.
        """
        newest: tuple[int, Estimate] | None = None
        sync, send_ids, live = self.decoder.sync, self._send_ids, self.live
        for frame in frames:
            if frame.error or frame.own or frame.remote:
                continue
            key = frame.can_id, frame.extended
            if key in send_ids:
                self.foreign += 1
                self._foreign_t_ns = frame.t_ns
                continue
            sample_ns = None if live is None else live.take(key, frame)
            if sample_ns is None:
                sample_ns = self._decode(frame)
            elif live is not None and _LOAD_CELL in live.names:
                self.load_cell.append((sample_ns, live.newest(_LOAD_CELL)))
            if sample_ns is not None and sync(frame):
                if newest is not None:
                    self.skipped += 1
                    self._encode(newest[1], 0)  # the counter counts what is left out
                newest = self._step(frame.t_ns, sample_ns)
        return [] if newest is None else self._published(*newest, now)

    def _decode(self, frame: Frame) -> int | None:
        """Push a frame's samples; their instant, None if there are none."""
        samples, method = self.decoder.decode(frame), self._method
        for signal, t_ns, value in samples:
            self.estimator.push(signal, t_ns, value)
            if method is not None:
                method.take(signal, t_ns, value)
            if signal == _LOAD_CELL:
                self.load_cell.append((t_ns, value))
        return samples[0].t_ns if samples else None

    def _step(self, receive_ns: int, sample_ns: int) -> tuple[int, Estimate]:
        """Sync stamp and estimate; where no grid point was due, the last one, older by now."""
        new = self.estimator.advance(sample_ns) > 0
        estimate = self.estimator.latest
        if self.levels is not None:
            self.levels.advance(sample_ns)
        if self._foreign_t_ns is not None:
            if abs(receive_ns - self._foreign_t_ns) < _FOREIGN_HOLD_NS:
                reason = estimate.reason | Reason.OTHER_TRANSMITTER
                estimate = estimate._replace(valid=False, reason=reason)
            else:
                self._foreign_t_ns = None
        self.repeated += not new
        if self.record is not None and new:
            self.record.append((receive_ns, estimate))
        age_ns = receive_ns - estimate.t_ns
        estimate = aged(estimate, age_ns, self._look_back_ns, self._age_limit_ns)
        kicked = self._shift.stale(self.decoder.moved_ns, receive_ns)
        if self._doubt.stale(estimate, receive_ns, sample_ns) or kicked:
            estimate = estimate._replace(valid=False, reason=estimate.reason | Reason.STALE)
        if self._start_wait_ns:
            estimate = self._waited(estimate, receive_ns)
        self.latest = estimate
        self.sync_t_ns = receive_ns
        self.steps += 1
        self.valid_steps += estimate.valid
        return receive_ns, estimate

    def _waited(self, estimate: Estimate, receive_ns: int) -> Estimate:
        """Settling for a while once all inputs are there; a clock that is set ends that."""
        if self._started_ns is None:
            if int(estimate.reason) & _UNSEEN:
                return estimate
            self._started_ns = receive_ns
        if 0 <= receive_ns - self._started_ns < self._start_wait_ns:
            return estimate._replace(valid=False, reason=estimate.reason | Reason.SETTLING)
        self._start_wait_ns = 0
        return estimate

    def _published(
        self, receive_ns: int, estimate: Estimate, now: Callable[[], int] | None
    ) -> list[Frame]:
        age_ns = (receive_ns if now is None else now()) - estimate.t_ns
        told = aged(estimate, age_ns, self._look_back_ns, self._age_limit_ns)
        self.stale += int(told.reason) & _STALE > 0
        self.latest = told
        return self._encode(told, age_ns)

    def _encode(self, told: Estimate, age_ns: int) -> list[Frame]:
        if self._encoder is None:
            return []
        values = estimate_values(told, status_of(told.reason), age_ns * 1e-9)
        return [self._encoder.frame(values)]

    def load_cell_at(self, t_ns: int) -> float | None:
        """Rack force of the rig at ``t_ns`` by the nearest sample within 10 ms, in N."""
        near = min(self.load_cell, key=lambda point: abs(point[0] - t_ns), default=None)
        if near is None or abs(near[0] - t_ns) > 10_000_000 or math.isnan(near[1]):
            return None
        return near[1]
