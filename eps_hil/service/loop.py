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
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port, open_port
from eps_hil.bus.socket_port import SocketPort
from eps_hil.errors import AbsentBusError, BusError
from eps_hil.estimation.validity import Reason, words
from eps_hil.service import realtime
from eps_hil.service.core import Status, silent_values
from eps_hil.service.ending import Ending
from eps_hil.service.estimate_log import EstimateLog
from eps_hil.service.health import Lateness, Loss, StepRate, Summary, health_values
from eps_hil.service.level_updates import LevelUpdates
from eps_hil.service.link import Link
from eps_hil.service.periodic_jobs import PeriodicJobs
from eps_hil.service.present import Present
from eps_hil.service.setup import Parts
from eps_hil.service.status_line import Snapshot
from eps_hil.service.systemd import Notifier
from eps_hil.service.verdict import verdict_values

_SHOW_PERIOD_S = 0.1
_TELL_PERIOD_S = 1.0
_LAST_TRIES, _LAST_WAIT_S = 50, 0.002
"""Within a tenth of a second a full send queue may have room for the last frame again."""

Say = Callable[[str], None]
Show = Callable[[Snapshot], None]
OpenPort = Callable[[Parts], Port]


def open_for(parts: Parts) -> Port:
    """The bus of the configuration: our inputs and, to notice another sender, our own ids."""
    bus = parts.config.bus
    port = open_port(
        bus.interface,
        bus.channel,
        fd=bus.fd,
        receive_ids=sorted({*parts.decoder.receive_ids, *parts.send_ids}),
        send_ids=parts.send_ids,
        never_send_ids=tuple(parts.commands),
        options=bus.options,
    )
    if isinstance(port, SocketPort):
        port.urgent_id = parts.decoder.sync_id
    return port


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
        levels: LevelUpdates | None = None,
        opener: OpenPort = open_for,
        notifier: Notifier | None = None,
        present: Present | None = None,
    ) -> None:
        self._parts, self._core = parts, parts.core
        self._levels = levels or LevelUpdates(parts, say)
        self._say, self._show, self._log = say, show, log
        self._notifier, self._present = notifier or Notifier({}), present or Present()
        self.ready = False
        self._ending, self._periodic = Ending(), PeriodicJobs(say)
        config = parts.config
        pause_s = config.service.reconnect_s if config.bus.reconnect else None
        self._link = Link(config.bus, lambda: opener(parts), self._deliver, say, pause_s)
        self._publishing = False
        self._published = 0
        self._lateness, self._rate, self._rate_hz = Lateness(), StepRate(), 0.0
        self._period_ns = round(parts.sync_period_s * 1e9)
        self._last_sync_s = 0.0
        self._silent = True
        self._tell_silence_s = 0.0
        self._memory_locked = False
        self._began_s = time.monotonic()

    async def run(self, duration_s: float | None = None) -> Summary:
        """Until a signal or ``duration_s``; :class:`BusError` for a lost bus without reconnect.

        Once it has begun to publish, its last frame says status "off", however the run ends.
        """
        self._loop = asyncio.get_running_loop()
        self._ending.watch_over(self._loop)
        self._memory_locked = realtime.quieten(self._parts.config.service.realtime)
        self._began_s = time.monotonic()
        try:
            with self._signals():
                await self._open_first(duration_s)
                await self._listen_first()
                await self._serve(duration_s)
        finally:
            self._link.close()
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
        loss = Loss.of(self._parts.decoder.faults, self._link.counts)
        spent_s = time.monotonic() - self._began_s
        failures = dict(self._periodic.failures)
        if self._log is not None and self._log.lost:
            failures["rows that the log lost"] = self._log.lost
        return Summary.of(
            self._core, self._lateness, loss, spent_s, self._published, self._link.losses, failures
        )

    async def _serve(self, duration_s: float | None) -> None:
        if self._ending.asked_for:
            return
        runtime = self._parts.config.service
        locked = ", memory locked" if self._memory_locked else ""
        self._say(f"run        {realtime.hurry(runtime.realtime, runtime.priority)}{locked}")
        self._publishing = bool(self._parts.send_ids)
        self._last_sync_s = self._loop.time()
        jobs = [*self._periodic_of(self._parts), self._periodic.keep("levels", self._levels.keep)]
        if self._log is not None:
            log = self._log
            jobs.append(self._periodic.keep("log", lambda: log.keep(self._core)))
        tasks = [self._ending.task(self._loop, job) for job in jobs]
        self.ready = True
        self._say("READY")
        self._notifier.ready(self._in_short())
        try:
            await self._ending.wait(duration_s)
        finally:
            self._publishing = False
            self._notifier.stopping()
            self._say_off()  # a disk that hangs holds up the jobs, not this
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    # The path of every frame.

    def _deliver(self, frames: list[Frame]) -> None:
        core = self._core
        steps, skipped = core.steps, core.skipped
        answer = core.on_frames(frames, self._present.now_ns)
        if self._publishing:
            for frame in answer:
                self._published += self._send(frame)
        if core.steps == steps:
            return
        self._last_sync_s = self._loop.time()
        self._silent = False
        late_ns = time.time_ns() - core.sync_t_ns
        for older in range(core.skipped - skipped + 1):
            self._lateness.add(late_ns + older * self._period_ns, self._period_ns)
        if self._publishing:
            self._periodic.answered()

    def _send(self, frame: Frame) -> bool:
        return self._link.send(frame)

    # What may be late.

    def _periodic_of(self, parts: Parts) -> Iterator[Coroutine[Any, Any, None]]:
        every, between = self._periodic.every, self._periodic.between
        publish = parts.config.publish
        runtime = parts.config.service
        look_s = min(runtime.no_input_period_s, runtime.no_input_after_s)
        yield every("no input", look_s, lambda: self._watch(look_s))
        if parts.verdict is not None:
            yield between("verdict", publish.verdict_period_s, self._tell_verdict)
        yield between("health", publish.health_period_s, self._tell_health)
        if self._levels.period_s < math.inf:
            yield every("levels on the bus", self._levels.period_s, self._tell_levels)
        if self._show is not None:
            yield every("status line", _SHOW_PERIOD_S, lambda: self._show_status(self._show))
        notifier = self._notifier
        yield every("systemd", _TELL_PERIOD_S, lambda: notifier.status(self._in_short()))
        if notifier.feed_s:  # by this loop itself: when it hangs, nothing is fed
            yield every("watchdog", notifier.feed_s, notifier.alive)

    def _watch(self, look_s: float) -> None:
        """The sync frame stopped: say so at once, then at a lower rate, until it is back."""
        runtime, now_s = self._parts.config.service, self._loop.time()
        if now_s - self._last_sync_s <= runtime.no_input_after_s:
            return
        if self._silent and now_s < self._tell_silence_s - 0.5 * look_s:
            return
        self._silent, told = True, self._send_silent(Status.INVALID)
        self._tell_silence_s = now_s + runtime.no_input_period_s if told else 0.0

    def _tell_health(self) -> None:
        self._rate_hz = self._rate.update(self._loop.time(), self._core.steps)
        self._link.tell_state()
        if self._parts.health is not None:
            loss = Loss.of(self._parts.decoder.faults, self._link.counts)
            values = health_values(
                loss, self._lateness, self._rate_hz, self._link.state, self._parts.health_modulo
            )
            self._send(self._parts.health.frame(values))

    def _tell_verdict(self) -> None:
        encoder, latest = self._parts.verdict, self._core.latest
        if encoder is not None:
            reason = Reason.NOT_STARTED if latest is None else latest.reason
            silent_at_ns = time.time_ns() if self._silent else None
            values = verdict_values(self._parts.estimator, reason, silent_at_ns)
            self._send(encoder.frame(values))

    def _tell_levels(self) -> None:
        for frame in self._levels.frames():
            self._send(frame)

    def _show_status(self, show: Show | None) -> None:
        if show is not None:
            lost = self._link.lost
            show(Snapshot.of(self._core, self._rate_hz, silent=self._silent, bus_lost=lost))

    def _in_short(self) -> str:
        core = self._core
        if self._link.lost or self._silent or core.latest is None:
            verdict = "bus lost" if self._link.lost else "no input"
        else:
            verdict = "valid" if core.latest.valid else f"invalid: {words(core.latest.reason)}"
        return f"{self._rate_hz:.0f} steps/s, {verdict}, {core.steps} steps"

    def _send_silent(self, status: Status) -> bool:
        encoder: FrameEncoder | None = self._parts.silent
        if encoder is None:
            return True
        return self._send(encoder.frame(silent_values(status, Reason.NO_INPUT)))

    def _say_off(self) -> None:
        """Also where the send queue is full: the last frame before may be a valid estimate."""
        for _ in range(_LAST_TRIES):
            if self._send_silent(Status.OFF) or self._link.lost:
                return
            time.sleep(_LAST_WAIT_S)

    async def _open_first(self, duration_s: float | None) -> None:
        """A bus that is not there yet is waited for, no longer than the run shall last."""
        told = [""]

        def waiting(why: str) -> None:
            told[0] = why
            self._notifier.waiting(why)

        def never_came() -> None:
            self._ending.fail(AbsentBusError(f"{told[0]}; it did not come within {duration_s:g} s"))

        end = None if duration_s is None else self._loop.call_later(duration_s, never_came)
        await self._link.open_first(self._loop, self._ending, waiting)
        if end is not None:
            end.cancel()

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
