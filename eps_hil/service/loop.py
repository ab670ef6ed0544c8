"""The asynchronous service: receive, decode, step, publish, and nothing else in that path.

Woken by the socket, because asyncio's timers round to a millisecond; timers only serve what may
be late: the watchdog over the sync frame, health frames, the status line. Frames are sent one by
one, never by a cyclic job of the kernel, so a service that hangs or dies goes silent.
"""

import asyncio
import contextlib
import math
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import astuple

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Port, PortCounts, open_port
from eps_hil.errors import BusError
from eps_hil.estimation.validity import Reason
from eps_hil.service import realtime
from eps_hil.service.core import Status, silent_values
from eps_hil.service.ending import Ending
from eps_hil.service.estimate_log import EstimateLog
from eps_hil.service.health import Lateness, Loss, StepRate, Summary, health_values
from eps_hil.service.level_desk import LevelDesk
from eps_hil.service.setup import Parts
from eps_hil.service.status_line import Snapshot

_SHOW_PERIOD_S = 0.1

Say = Callable[[str], None]
Show = Callable[[Snapshot], None]
OpenPort = Callable[[Parts], Port]


def open_for(parts: Parts) -> Port:
    """The bus of the configuration: our inputs and, to notice another sender, our own ids."""
    bus = parts.config.bus
    return open_port(
        bus.interface,
        bus.channel,
        fd=bus.fd,
        receive_ids=sorted({*parts.decoder.receive_ids, *parts.send_ids}),
        send_ids=parts.send_ids,
        options=bus.options,
    )


class Service:
    """One run of the service on one bus.

    ``say`` gets lines for a person; ``show`` a snapshot ten times a second; ``log`` every
    estimate; ``levels`` looks after friction levels. None of them is called between a frame's
    arrival and its answer.
    """

    def __init__(
        self,
        parts: Parts,
        say: Say,
        *,
        show: Show | None = None,
        log: EstimateLog | None = None,
        levels: LevelDesk | None = None,
        opener: OpenPort = open_for,
    ) -> None:
        self._parts, self._core = parts, parts.core
        self._levels = levels or LevelDesk(parts, say)
        self._say, self._show, self._log, self._opener = say, show, log, opener
        self.ready = False
        self._ending = Ending()
        self._port: Port | None = None
        self._past = PortCounts()
        self._publishing = False
        self._published = 0
        self._lateness, self._rate, self._rate_hz = Lateness(), StepRate(), 0.0
        self._period_ns = round(parts.sync_period_s * 1e9)
        self._last_sync_s = 0.0
        self._silent = True
        self._memory_locked = False
        self._began_s = time.monotonic()

    async def run(self, duration_s: float | None = None) -> Summary:
        """Until a signal, ``duration_s`` or a lost bus; :class:`BusError` for the last.

        Once it has begun to publish, its last frame says status "off", however the run ends.
        """
        self._loop = asyncio.get_running_loop()
        self._ending.watch_over(self._loop)
        self._memory_locked = realtime.quieten(self._parts.config.service.realtime)
        self._began_s = time.monotonic()
        try:
            with self._signals():
                self._connect()
                await self._listen_first()
                await self._serve(duration_s)
        finally:
            self._disconnect()
        self._ending.raise_failure()
        return self.summary()

    def stop(self) -> None:
        """End the run cleanly; to be called in the loop's thread."""
        self._ending.ask()

    def take_levels(self) -> None:
        """Friction levels anew from the model file; to be called in the loop's thread."""
        self._rereading = self._ending.task(self._loop, self._levels.reread())

    def summary(self) -> Summary:
        """What the run came to so far."""
        loss = Loss.of(self._parts.decoder.faults, self._counts())
        spent_s = time.monotonic() - self._began_s
        return Summary.of(self._core, self._lateness, loss, spent_s, self._published)

    async def _serve(self, duration_s: float | None) -> None:
        if self._ending.asked_for:
            return
        runtime = self._parts.config.service
        locked = ", memory locked" if self._memory_locked else ""
        self._say(f"run        {realtime.hurry(runtime.realtime, runtime.priority)}{locked}")
        self._publishing = bool(self._parts.send_ids)
        self._last_sync_s = self._loop.time()
        jobs = [self._watch(), self._tell_health(), self._levels.keep()]
        jobs += [self._tell_levels()] if self._levels.period_s < math.inf else []
        jobs += [] if self._show is None else [self._show_status(self._show)]
        jobs += [] if self._log is None else [self._log.keep(self._core)]
        tasks = [self._ending.task(self._loop, job) for job in jobs]
        self.ready = True
        self._say("READY")
        try:
            await self._ending.wait(duration_s)
        finally:
            self._publishing = False
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self._send_silent(Status.OFF)

    # The path of every frame.

    def _deliver(self, frames: list[Frame]) -> None:
        core = self._core
        steps, skipped = core.steps, core.skipped
        answer = core.on_frames(frames)
        if self._publishing:
            for frame in answer:
                self._send(frame)
                self._published += 1
        if core.steps == steps:
            return
        self._last_sync_s = self._loop.time()
        self._silent = False
        late_ns = time.time_ns() - core.sync_t_ns
        for older in range(core.skipped - skipped + 1):
            self._lateness.add(late_ns + older * self._period_ns, self._period_ns)

    def _send(self, frame: Frame) -> None:
        if self._port is None:
            return
        try:
            self._port.send(frame)
        except BusError as error:
            self._lost(str(error))

    # What may be late.

    async def _watch(self) -> None:
        """The sync frame stopped: say so, at a lower rate, until it is back."""
        runtime = self._parts.config.service
        while True:
            await asyncio.sleep(runtime.no_input_period_s)
            if self._loop.time() - self._last_sync_s > runtime.no_input_after_s:
                self._silent = True
                self._send_silent(Status.INVALID)

    async def _tell_health(self) -> None:
        while True:
            await asyncio.sleep(self._parts.config.publish.health_period_s)
            self._rate_hz = self._rate.update(self._loop.time(), self._core.steps)
            if self._parts.health is not None:
                loss = Loss.of(self._parts.decoder.faults, self._counts())
                state = BusState.LOST if self._port is None else self._port.state
                values = health_values(loss, self._lateness, self._rate_hz, state)
                self._send(self._parts.health.frame(values))

    async def _tell_levels(self) -> None:
        while True:
            await asyncio.sleep(self._levels.period_s)
            for frame in self._levels.frames():
                self._send(frame)

    async def _show_status(self, show: Show) -> None:
        while True:
            await asyncio.sleep(_SHOW_PERIOD_S)
            bus_lost = self._port is None
            show(Snapshot.of(self._core, self._rate_hz, silent=self._silent, bus_lost=bus_lost))

    def _send_silent(self, status: Status) -> None:
        encoder: FrameEncoder | None = self._parts.silent
        if encoder is not None:
            self._send(encoder.frame(silent_values(status, Reason.NO_INPUT)))

    # The bus coming and going.

    def _connect(self) -> None:
        self._port = self._opener(self._parts)
        self._port.start(self._loop, self._deliver, self._lost)

    async def _listen_first(self) -> None:
        """Two transmitters of one id ruin both: hear whether ours is taken before using it."""
        listen_s = self._parts.config.publish.listen_first_s
        if not self._parts.send_ids or not listen_s:
            return
        await self._ending.wait(listen_s)
        if self._core.foreign:
            ids = ", ".join(f"0x{can_id:X}" for can_id in self._parts.send_ids)
            raise BusError(
                f"{self._parts.config.bus}: another transmitter sends our ids ({ids}); "
                "end the other service, or set publish.enabled: false"
            )

    def _lost(self, reason: str) -> None:
        if self._port is None:
            return
        self._disconnect()
        if not self._parts.config.bus.reconnect:
            self._ending.fail(BusError(f"{self._parts.config.bus}: the bus is lost: {reason}"))
            return
        self._say(f"bus lost   {reason}; waiting for it (bus.reconnect)")
        self._reconnecting = self._loop.create_task(self._reconnect())

    async def _reconnect(self) -> None:
        while not self._ending.asked_for:
            await self._ending.wait(self._parts.config.service.reconnect_s)
            if self._ending.asked_for:
                return
            with contextlib.suppress(BusError):
                self._connect()
                self._say("bus back   going on")
                return

    def _disconnect(self) -> None:
        if self._port is not None:
            port, self._port = self._port, None
            port.close()
            self._past = _sum(self._past, port.counts)

    def _counts(self) -> PortCounts:
        return self._past if self._port is None else _sum(self._past, self._port.counts)

    # Ends.

    @contextlib.contextmanager
    def _signals(self) -> Iterator[None]:
        """SIGINT, SIGTERM and SIGHUP end the run; a second SIGINT ends the process at once.

        SIGUSR1 takes friction levels anew from the model file.
        """
        caught = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # started with nohup
            caught.append(signal.SIGHUP)

        def stop() -> None:
            self.stop()
            self._loop.remove_signal_handler(signal.SIGINT)
            signal.signal(signal.SIGINT, signal.SIG_DFL)

        try:
            for number in caught:
                self._loop.add_signal_handler(number, stop)
            self._loop.add_signal_handler(signal.SIGUSR1, self.take_levels)
            caught.append(signal.SIGUSR1)
        except (RuntimeError, ValueError):  # not in the main thread: its owner has the signals
            caught = []
        try:
            yield
        finally:
            for number in caught:
                self._loop.remove_signal_handler(number)


def _sum(one: PortCounts, other: PortCounts) -> PortCounts:
    return PortCounts(*(a + b for a, b in zip(astuple(one), astuple(other), strict=True)))
