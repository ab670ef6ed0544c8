"""The recorder: a thread for each channel that does nothing but receive, and one that writes.

A disk that stands still for a second (fsync, a full queue of the device) keeps nobody from
receiving; what is received meanwhile waits in memory. On a machine that is too busy the kernel
keeps some 15 s of a 1 kHz rig for us, and where permitted all threads have the lowest real-time
priority: below the service's, above everything that is not in real time. One for the receivers
alone would not do: they share the interpreter's lock with the one that writes. A channel whose
interface goes down is opened again, and its outage is written down.
"""

import contextlib
import os
import sys
import threading
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port, PortCounts
from eps_hil.bus.reconnecting_port import Outage, ReconnectingPort
from eps_hil.bus.record_counts import CounterField, Counts, Key
from eps_hil.bus.record_parts import Parts, Target
from eps_hil.bus.record_sidecar import utc
from eps_hil.bus.socket_port import SocketPort
from eps_hil.errors import BusError, EpsHilError

QUEUE_FRAMES = 500_000
"""So many frames may wait for the disk; more are counted as lost. A minute of a full bus."""
BUFFER_BYTES = 64 << 20
"""For the kernel to keep what came and is not read yet: some 70,000 frames, if it may."""
PRIORITY = 1
_SWITCH_S = 0.001
_WAIT_S = 0.1
_REST_S = 0.5  # a bus that never pauses is left after that long


class RecordError(EpsHilError):
    """Frames were lost, or the bus is gone; what was written is readable."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One bus to record: ``name`` in the log, what the sidecar says of it, and how to open it.

    ``reconnect``: open it again when it is lost (the default); without, its loss ends everything.
    """

    name: str
    opener: Callable[[], Port]
    about: Mapping[str, Any] = field(default_factory=dict)
    reconnect: bool = True


@dataclass(frozen=True, slots=True)
class RecordReport:
    """``frames`` written in ``parts`` files; ``lost`` before us in the kernel, ``lost_waiting`` for
    the disk in memory, ``lost_on_full_disk``; ``outages`` of the bus."""

    frames: int
    parts: int
    lost: int
    lost_waiting: int
    lost_on_full_disk: int
    error_frames: int
    outages: int
    duration_s: float
    file_bytes: int


def with_room(port: Port) -> Port:
    """The port with a large receive buffer, where that is ours to set."""
    if isinstance(port, SocketPort):
        port.widen(BUFFER_BYTES)
    return port


def take_priority() -> bool:
    """The lowest real-time priority for the calling thread, where permitted; children get none."""
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(PRIORITY))
    except (AttributeError, OSError):  # not Linux, or not allowed
        return False
    return True


class _Receiver(threading.Thread):
    """Receives one channel into the queue, until told to stop or the bus is gone for good."""

    def __init__(
        self, number: int, channel: Channel, waiting: "_Waiting", say: Any, realtime: bool
    ) -> None:
        super().__init__(name=f"receive {channel.name}", daemon=True)
        self._realtime = realtime

        def opener() -> Port:
            return with_room(channel.opener())

        self.port: Port | ReconnectingPort
        if channel.reconnect:
            self.port = ReconnectingPort(
                opener, lambda line: say(f"{channel.name}: {line}"), name=channel.name
            )
        else:
            self.port = opener()
        self.counts = PortCounts()
        self.lost_waiting = 0
        self.gone = ""
        self._number, self._waiting = number, waiting
        self._stopped = threading.Event()

    @property
    def outages(self) -> list[Outage]:
        return self.port.outages if isinstance(self.port, ReconnectingPort) else []

    def run(self) -> None:
        if self._realtime:
            take_priority()
        try:
            while not self._stopped.is_set():
                self._take(self.port.recv(_WAIT_S))
            self._rest()
        except BusError as error:
            self.gone = str(error)
        self.counts = self.port.counts

    def _take(self, frames: list[Frame]) -> None:
        self.counts = self.port.counts
        if frames and not self._waiting.put(self._number, frames):
            self.lost_waiting += len(frames)

    def _rest(self) -> None:
        """What came before the stop and is not read yet, as on a machine that was busy."""
        until_s = time.monotonic() + _REST_S
        with contextlib.suppress(BusError):  # gone while it was left anyway
            while frames := self.port.recv(0.0):
                self._take(frames)
                if time.monotonic() >= until_s:
                    break

    def stop(self) -> None:
        self._stopped.set()


class _Waiting:
    """Frames between the receivers and the disk; bounded, and never waited for.

    On a condition, since a :class:`queue.SimpleQueue` whose wait ends at the moment of a signal
    waits for ever (CPython 3.11): Ctrl-C would not have stopped the recorder.
    """

    def __init__(self) -> None:
        self._batches: list[tuple[int, list[Frame]]] = []
        self._filled = threading.Condition()
        self._frames = 0

    def put(self, channel: int, frames: list[Frame]) -> bool:
        with self._filled:
            if self._frames + len(frames) > QUEUE_FRAMES:
                return False
            self._frames += len(frames)
            self._batches.append((channel, frames))
            self._filled.notify()
        return True

    def take(self, timeout_s: float) -> list[tuple[int, list[Frame]]]:
        """All that waits, in the order of the stamps as far as batches go."""
        with self._filled:
            if not self._batches:
                self._filled.wait(timeout_s)
            found, self._batches, self._frames = self._batches, [], 0
        return found


class Recorder:
    """A recording; opening the channels and the first file has to work, whatever comes later.

    ``about``: what the sidecar says beside the counts; ``say`` gets a line for each event;
    ``realtime``: priority for its threads, that of :meth:`run` included, where permitted.
    """

    def __init__(
        self,
        channels: Sequence[Channel],
        target: Target,
        *,
        about: Mapping[str, Any] | None = None,
        counters: Mapping[Key, CounterField] | None = None,
        say: Callable[[str], None] = lambda _: None,
        realtime: bool = False,
    ) -> None:
        """:class:`BusError` or :class:`~eps_hil.errors.InputError` for what cannot be opened."""
        target.check()
        self._about = {"recording": uuid.uuid4().hex, **(about or {})}
        self._channels, self._realtime = channels, realtime
        self._waiting = _Waiting()
        self._receivers: list[_Receiver] = []
        try:
            for number, channel in enumerate(channels):
                self._receivers.append(_Receiver(number, channel, self._waiting, say, realtime))
            self.parts = Parts(
                target, [one.name for one in channels], counters or {}, self._describe, say
            )
        except BaseException:
            for receiver in self._receivers:
                receiver.port.close()
            raise

    @property
    def names(self) -> list[str]:
        """Of the ports."""
        return [receiver.port.name for receiver in self._receivers]

    def run(
        self,
        *,
        duration_s: float | None = None,
        stop: Callable[[], bool] = lambda: False,
        progress: Callable[[int], None] | None = None,
    ) -> RecordReport:
        """Until ``stop()``, ``duration_s``, or the end of a bus that is not to be opened again.

        :class:`RecordError` for the last, and where a full disk cost frames; all else is in the
        files then.
        """
        started_s, gone = time.monotonic(), ""
        if self._realtime:
            sys.setswitchinterval(_SWITCH_S)  # the one that writes lets receivers go on sooner
            take_priority()
        for receiver in self._receivers:
            receiver.start()
        try:
            while not stop() and not (gone := self._gone()):
                if duration_s is not None and time.monotonic() - started_s >= duration_s:
                    break
                self._write(_WAIT_S)
                if progress is not None:
                    progress(self.parts.frames)
        finally:
            self._end()
        report = self._report(time.monotonic() - started_s)
        self._judge(report, gone)
        return report

    def _write(self, timeout_s: float) -> None:
        batches = self._waiting.take(timeout_s)
        for channel, frames in _in_order(batches) if len(self._channels) > 1 else batches:
            self.parts.write(channel, frames)
        self.parts.tick()

    def _end(self) -> None:
        for receiver in self._receivers:
            receiver.stop()
        for receiver in self._receivers:
            while receiver.is_alive():
                self._write(0.02)
            receiver.port.close()
        self._write(0.0)
        self.parts.close()

    def _describe(self, counts: Counts) -> dict[str, Any]:
        """The sidecar's part that the files know nothing of."""
        channels = []
        for number, (channel, receiver) in enumerate(
            zip(self._channels, self._receivers, strict=True)
        ):
            now = receiver.counts
            channels.append(
                {
                    "name": channel.name,
                    **channel.about,
                    **counts.told(number),
                    "since_start": {
                        "received": now.received,
                        "lost_in_kernel": now.lost_in_kernel,
                        "lost_waiting_for_disk": receiver.lost_waiting,
                    },
                    "outages": [
                        {
                            "from": utc(one.since_ns),
                            "to": utc(one.until_ns) if one.until_ns else None,
                            "reason": one.reason,
                        }
                        for one in receiver.outages
                    ],
                }
            )
        return {**self._about, "channels": channels}

    def _report(self, duration_s: float) -> RecordReport:
        receivers = self._receivers
        return RecordReport(
            frames=self.parts.frames,
            parts=len(self.parts.paths),
            lost=sum(one.counts.lost_in_kernel for one in receivers),
            lost_waiting=sum(one.lost_waiting for one in receivers),
            lost_on_full_disk=self.parts.lost,
            error_frames=sum(one.counts.error_frames for one in receivers),
            outages=sum(len(one.outages) for one in receivers),
            duration_s=duration_s,
            file_bytes=sum(path.stat().st_size for path in self.parts.paths if path.exists()),
        )

    def _gone(self) -> str:
        return "; ".join(one.gone for one in self._receivers if one.gone)

    def _judge(self, report: RecordReport, gone: str) -> None:
        held = f"{report.frames} frames are in {report.parts} readable files"
        if report.parts == 1:
            held = f"{self.parts.paths[0]} holds the {report.frames} frames before that"
        if gone:
            raise RecordError(f"{gone}; {held}")
        if report.lost_on_full_disk or report.lost_waiting:
            lost = report.lost_on_full_disk + report.lost_waiting
            raise RecordError(f"{lost} frames were lost on a full or slow disk; {held}")


def _in_order(batches: list[tuple[int, list[Frame]]]) -> list[tuple[int, list[Frame]]]:
    """Frames of several channels in the order of their stamps, in runs of one channel.

    Those of one channel stay in their order: its clock may have been set back.
    """
    newest: dict[int, int] = {}
    tagged = []
    for channel, frames in batches:
        for frame in frames:
            newest[channel] = max(newest.get(channel, frame.t_ns), frame.t_ns)
            tagged.append((newest[channel], channel, frame))
    tagged.sort(key=lambda one: one[0])
    runs: list[tuple[int, list[Frame]]] = []
    for _, channel, frame in tagged:
        if runs and runs[-1][0] == channel:
            runs[-1][1].append(frame)
        else:
            runs.append((channel, [frame]))
    return runs
