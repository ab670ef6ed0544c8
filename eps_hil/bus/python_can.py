"""Every interface that python-can knows, as a port: ``virtual``, ``socketcand``, PCAN, Vector...

Where the driver gives a file descriptor the loop watches it; otherwise a reader thread hands
whole batches over. What python-can cannot tell stays unknown: ``lost_in_kernel`` is 0, and
stamps are float seconds (some 200 ns of resolution) by the driver's clock, which is followed onto
the epoch (:mod:`eps_hil.bus.stamp_offset`).
"""

import asyncio
import contextlib
import difflib
import errno
import logging
import threading
import time
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import can

from eps_hil.bus.commands import OWN
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Deliver, OnLost, PortCounts, SendRule
from eps_hil.bus.stamp_offset import StampOffset
from eps_hil.errors import BusError

_BATCH_MAX = 1024
_WAKE_S = 0.1  # how long the reader thread sleeps at most before it looks whether to stop
_JOIN_S = 2.0
_APART_NS = 100_000


class PythonCanPort:
    """A python-can bus; implements :class:`~eps_hil.bus.port.Port`."""

    def __init__(
        self,
        interface: str,
        channel: str,
        *,
        fd: bool = False,
        receive_ids: Sequence[int] | None = None,
        send_ids: Sequence[int] | None = None,
        never_send_ids: Collection[int] = tuple(OWN),
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Open the bus; :class:`BusError` in one line, with the remedy, when it cannot be."""
        self.name = f"{interface}:{channel}"
        self._channel = channel
        self._receive_ids = None if receive_ids is None else frozenset(receive_ids)
        self._rule = SendRule(self.name, send_ids, never_send_ids)
        self._bus = _open(interface, channel, fd, receive_ids, dict(options or {}))
        self._loop: asyncio.AbstractEventLoop | None = None
        self._deliver: Deliver | None = None
        self._on_lost: OnLost | None = None
        self._thread: threading.Thread | None = None
        self._watched = -1
        self._closing = False
        self._lost_reason = ""
        self._offset = StampOffset()
        self._received = self._sent = self._dropped = self._errors = 0

    @property
    def counts(self) -> PortCounts:
        """A snapshot; python-can does not say what a driver lost."""
        return PortCounts(self._received, self._sent, self._dropped, 0, self._errors)

    @property
    def state(self) -> BusState:
        """What the driver says, where it says anything."""
        if self._lost_reason:
            return BusState.LOST
        try:
            said = self._bus.state
        except Exception:  # optional in python-can; a driver without it is not an error
            return BusState.UNKNOWN
        return {
            can.BusState.ERROR: BusState.BUS_OFF,
            can.BusState.PASSIVE: BusState.ERROR_PASSIVE,
        }.get(said, BusState.ERROR_ACTIVE)

    def start(
        self, loop: asyncio.AbstractEventLoop, deliver: Deliver, on_lost: OnLost | None = None
    ) -> None:
        """See :meth:`eps_hil.bus.port.Port.start`."""
        self._loop, self._deliver, self._on_lost = loop, deliver, on_lost
        try:
            descriptor = self._bus.fileno()
            if descriptor >= 0:
                loop.add_reader(descriptor, self._on_readable)
                self._watched = descriptor
                return
        except (NotImplementedError, ValueError, OSError):
            pass  # no descriptor that this loop can watch
        self._thread = threading.Thread(target=self._read, name=self.name, daemon=True)
        self._thread.start()

    def send(self, frame: Frame) -> bool:
        """See :meth:`eps_hil.bus.port.Port.send`."""
        self._rule.check(frame)
        if self._closing or self._lost_reason:
            raise BusError(f"{self.name}: {self._lost_reason or 'the port is closed'}")
        try:
            self._bus.send(to_message(frame), timeout=0)
        except (can.CanOperationError, can.CanTimeoutError) as error:
            # A driver's full queue and its failure look alike here; what is gone for good
            # shows on the receiving side as well.
            if _is_gone(error):
                self._lost_reason = _one_line(error)
                self._tell_lost()
                raise BusError(f"{self.name}: {self._lost_reason}") from None
            self._dropped += 1
            return False
        except (can.CanError, OSError, ValueError) as error:
            raise BusError(f"{self.name}: cannot send: {_one_line(error)}") from None
        self._sent += 1
        return True

    def recv(self, timeout_s: float) -> list[Frame]:
        """See :meth:`eps_hil.bus.port.Port.recv`."""
        if self._closing or self._lost_reason:
            raise BusError(f"{self.name}: {self._lost_reason or 'the port is closed'}")
        deadline = time.monotonic() + timeout_s
        while True:
            frames = self._drain(max(0.0, deadline - time.monotonic()))
            if self._lost_reason and not frames:
                raise BusError(f"{self.name}: {self._lost_reason}")
            if frames or time.monotonic() >= deadline:
                return frames

    def close(self) -> None:
        """Stop the reader and shut the bus down."""
        if self._closing:
            return
        self._closing = True
        self._stop_watching()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(_JOIN_S)
        self._loop = self._deliver = None
        with contextlib.suppress(can.CanError, OSError):  # it may be gone already
            self._bus.shutdown()

    def _on_readable(self) -> None:
        self._hand_over(self._drain(0.0))
        if self._lost_reason:
            self._tell_lost()

    def _read(self) -> None:
        """The reader thread: one call into the loop for everything that is pending."""
        while not self._closing and not self._lost_reason:
            frames = self._drain(_WAKE_S)
            loop = self._loop
            if loop is None or loop.is_closed():
                return
            try:
                if frames:
                    loop.call_soon_threadsafe(self._hand_over, frames)
                if self._lost_reason and not self._closing:
                    loop.call_soon_threadsafe(self._tell_lost)
            except RuntimeError:  # the loop was closed between the look and the call
                return

    def _hand_over(self, frames: list[Frame]) -> None:
        if frames and self._deliver is not None and not self._closing:
            self._deliver(frames)

    def _drain(self, timeout_s: float) -> list[Frame]:
        frames: list[Frame] = []
        try:
            message = self._bus.recv(timeout_s)
            while message is not None:
                frame = self._to_frame(message)
                if frame is not None:
                    frames.append(frame)
                if len(frames) >= _BATCH_MAX:
                    break
                message = self._bus.recv(0)
        except Exception as error:  # drivers raise whatever their vendor's library does
            if not self._closing:
                self._lost_reason = _one_line(error)
        self._received += len(frames)
        return frames

    def _to_frame(self, message: can.Message) -> Frame | None:
        error = bool(message.is_error_frame)
        if error:
            self._errors += 1
        elif self._receive_ids is not None and message.arbitration_id not in self._receive_ids:
            return None
        return from_message(message, self._epoch_ns(message.timestamp))

    def _epoch_ns(self, timestamp_s: float) -> int:
        wall_ns, steady_ns = _clocks()
        if not timestamp_s:
            return wall_ns
        return self._offset.on_epoch(round(timestamp_s * 1e9), wall_ns, steady_ns)

    def _tell_lost(self) -> None:
        self._stop_watching()
        told, self._on_lost = self._on_lost, None
        if told is not None:
            told(self._lost_reason)

    def _stop_watching(self) -> None:
        if self._watched >= 0 and self._loop is not None and not self._loop.is_closed():
            self._loop.remove_reader(self._watched)
        self._watched = -1


def _clocks() -> tuple[int, int]:
    """CLOCK_REALTIME and CLOCK_MONOTONIC of one moment, in ns."""
    for _ in range(10):
        steady_ns, wall_ns = time.monotonic_ns(), time.time_ns()
        if time.monotonic_ns() - steady_ns < _APART_NS:  # else somebody else ran in between
            break
    return wall_ns, steady_ns


def to_message(frame: Frame, channel: str | int | None = None) -> can.Message:
    """The frame as python-can knows it; its stamp as float seconds since the epoch."""
    return can.Message(
        timestamp=frame.t_ns / 1e9,
        arbitration_id=frame.can_id,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        is_error_frame=frame.error,
        is_fd=frame.fd,
        is_rx=not frame.own,
        bitrate_switch=frame.brs,
        error_state_indicator=frame.esi,
        channel=channel,
        data=frame.data,
        dlc=frame.remote_length if frame.remote else len(frame.data),
    )


def from_message(message: can.Message, t_ns: int) -> Frame:
    """A python-can message as a frame that is stamped ``t_ns``."""
    return Frame(
        t_ns=t_ns,
        can_id=message.arbitration_id,
        data=b"" if message.is_remote_frame else bytes(message.data),
        extended=bool(message.is_extended_id),
        fd=bool(message.is_fd),
        error=bool(message.is_error_frame),
        own=not message.is_rx,
        remote=bool(message.is_remote_frame),
        brs=bool(message.bitrate_switch),
        esi=bool(message.error_state_indicator),
        remote_length=min(message.dlc, 8) if message.is_remote_frame else 0,
    )


def _open(
    interface: str,
    channel: str,
    fd: bool,
    receive_ids: Sequence[int] | None,
    options: dict[str, Any],
) -> can.BusABC:
    if interface not in can.VALID_INTERFACES:
        near = difflib.get_close_matches(interface, sorted(can.VALID_INTERFACES), 1)
        meant = f"did you mean {near[0]}?" if near else "see python-can's list of interfaces"
        raise BusError(f"'{interface}' is not an interface that python-can knows; {meant}")
    logging.getLogger("can").addHandler(logging.NullHandler())  # errors reach people as ours
    if fd:
        options.setdefault("fd", True)
    if receive_ids is not None:
        options.setdefault(
            "can_filters", [{"can_id": one, "can_mask": 0x1FFF_FFFF} for one in receive_ids]
        )
    try:
        return can.Bus(interface=interface, channel=channel, ignore_config=True, **options)
    except (can.CanInterfaceNotImplementedError, ImportError) as error:
        raise BusError(
            f"{interface}: its driver is not installed ({_one_line(error)}); "
            f"install the vendor's driver, or pip install 'python-can[{interface}]'"
        ) from None
    except (TypeError, ValueError, KeyError) as error:
        raise BusError(
            f"{interface}:{channel}: an option does not fit ({_one_line(error)}); "
            "see python-can's page on this interface"
        ) from None
    except Exception as error:  # drivers raise whatever their vendor's library does
        said = _one_line(error).rstrip(".")
        missing = "library" in said.lower() and "not found" in said.lower()
        remedy = "install the vendor's driver" if missing else "is it connected, the channel right?"
        raise BusError(f"{interface}:{channel} cannot be opened: {said}; {remedy}") from None


def _is_gone(error: BaseException) -> bool:
    cause = error.__cause__
    code = getattr(cause, "errno", None) or getattr(error, "error_code", None)
    return code in {errno.ENODEV, errno.ENETDOWN, errno.ENXIO, errno.EPIPE, errno.ECONNRESET}


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
