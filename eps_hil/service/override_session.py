"""An override session on a bus: the asyncio shell around :class:`OverrideCore`.

Frames are sent one by one, each in answer to a sync frame, never by a cyclic job of the kernel: a
process that hangs or dies goes silent, and the ECU's own time-out does the rest. However the run
ends (done, signal, exception, lost bus), the last frames are releases, and it is written down. The
bus is never opened again within a session: after a loss the operator starts anew.
"""

import asyncio
import contextlib
import math
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator

from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port, open_port
from eps_hil.errors import BusError
from eps_hil.service import realtime
from eps_hil.service.ending import Ending
from eps_hil.service.guard import Trip
from eps_hil.service.journal import Journal
from eps_hil.service.listening import silent
from eps_hil.service.operator import Operator
from eps_hil.service.override import State, Transition
from eps_hil.service.override_core import OverrideCore, Source
from eps_hil.service.override_setup import OverrideParts

_TIMER_S = 0.003
_SHOW_S = 0.1
_LATE_NS = 5_000_000
"""A command not handed to the bus so long after it was decided (a stopped process) is not sent."""
_LAST_TRIES, _LAST_WAIT_S = 50, 0.002
"""Within a tenth of a second a full send queue may have room for the releases again."""

Say = Callable[[str], None]
OpenPort = Callable[[OverrideParts, bool], Port]


def open_for(parts: OverrideParts, dry_run: bool) -> Port:
    """The bus of the configuration; a dry run gets a port that cannot send."""
    bus = parts.config.bus
    return open_port(
        bus.interface,
        bus.channel,
        fd=bus.fd,
        receive_ids=parts.receive_ids,
        send_ids=() if dry_run else parts.send_ids,
        never_send_ids=parts.never_send_ids,
        options=bus.options,
    )


class OverrideSession:
    """One session; a fault ends it. ``over`` (asked ten times a second): the source has finished.

    ``say`` gets lines for a person, ``show`` is called ten times a second to paint what it likes.
    """

    def __init__(
        self,
        parts: OverrideParts,
        source: Source,
        operator: Operator | None,
        say: Say,
        *,
        over: Callable[[], bool] = lambda: False,
        show: Callable[[OverrideCore], None] | None = None,
        journal: Journal | None = None,
        opener: OpenPort = open_for,
        silence_s: float = math.inf,
    ) -> None:
        """``operator`` None: a dry run, which sends nothing at all.

        ``silence_s``: so long without a sync frame, while no torque is on, ends it (the guard
        sees to it while one is).
        """
        self._parts, self._operator, self._say = parts, operator, say
        self._over, self._show = over, show
        self._journal = journal or Journal(None)
        self._unwritten: deque[tuple[Transition, int]] = deque()
        """With the wall clock's time; what the disk refused is tried again."""
        self._opener, self._dry_run = opener, operator is None
        self.core = OverrideCore(parts, source, dry_run=self._dry_run)
        self.fault: Transition | None = None
        """The last transition into the state fault, if there was one."""
        self._ending = Ending(self._on_error)
        self._port: Port | None = None
        self._lost_frames = 0
        self._only_listens = False
        """Until nobody else is known to send our ids: a frame would end another's session."""
        self._why, self._abnormal = "done", False
        self._silence_s = silence_s

    async def run(self, duration_s: float | None = None) -> None:
        """Until the source is over, a fault, a signal, ``duration_s`` or a lost bus.

        :class:`BusError` for the last; whatever else went wrong is raised after the teardown,
        but for a disk or terminal that failed beside a fault: the fault is what matters then.
        """
        self._loop = asyncio.get_running_loop()
        self._ending.watch_over(self._loop)
        runtime = self._parts.config.service
        realtime.quieten(runtime.realtime)
        with self._signals():
            try:
                await self._listen_first()
                await self._serve(duration_s)
            except BaseException:
                self._abnormal, self._why = True, "an error ended the run"
                raise
            finally:
                self._tear_down()
        if self.fault is None or not isinstance(self._ending.failure, OSError):
            self._ending.raise_failure()

    # The desk of the operator.

    def prepare(self) -> bool:
        """First step of arming."""
        done = self.core.prepare(time.monotonic_ns())
        self._record()
        return done

    def arm(self) -> bool:
        """Second step of arming."""
        done = self.core.arm(time.monotonic_ns())
        self._record()
        return done

    def heartbeat(self) -> None:
        """The operator's sign of life."""
        self.core.heartbeat(time.monotonic_ns())

    def finish(self, why: str) -> None:
        """End the session; a torque that is still on is a fault then."""
        self._why, self._abnormal = why, self.core.state is State.INJECTING
        self._ending.ask()

    # Running.

    async def _listen_first(self) -> None:
        """The bus, and whether somebody else already sends what we would; nothing is sent yet."""
        self._only_listens = True
        self._port = self._opener(self._parts, self._dry_run)
        self.core.start(time.monotonic_ns())
        self._port.start(self._loop, self._deliver, self._lost)
        listen_s = self._parts.config.publish.listen_first_s
        await self._ending.wait(listen_s)
        if self.core.foreign and not self._dry_run:
            ids = ", ".join(f"0x{can_id:X}" for can_id in self._parts.send_ids)
            raise BusError(f"{self._parts.config.bus}: somebody else sends our ids ({ids}); end it")
        self._only_listens = self._ending.asked_for

    async def _serve(self, duration_s: float | None) -> None:
        if self._ending.asked_for:
            return
        runtime = self._parts.config.service
        self._tell(f"run        {realtime.hurry(runtime.realtime, runtime.priority)}")
        tasks = [self._ending.task(self._loop, job) for job in (self._time(), self._look())]
        if self._operator is not None:
            self._operator.start(self._loop, self)
        self._tell("READY")
        try:
            await self._ending.wait(duration_s)
        finally:
            if self._operator is not None:
                self._operator.stop()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    def _deliver(self, frames: list[Frame]) -> None:
        now_ns = time.monotonic_ns()
        self._send(self.core.on_frames(frames, now_ns, time.time_ns()), now_ns)
        self._record()

    async def _time(self) -> None:
        while True:
            await asyncio.sleep(_TIMER_S)
            if self._port is not None:
                lost = self._port.counts.lost_in_kernel
                fresh, self._lost_frames = lost - self._lost_frames, lost
                self.core.on_bus(time.monotonic_ns(), self._port.state, fresh)
            now_ns = time.monotonic_ns()
            self._send(self.core.on_timer(now_ns), now_ns)
            self._record()

    async def _look(self) -> None:
        syncs, heard_s = self.core.syncs, self._loop.time()
        while True:
            await asyncio.sleep(_SHOW_S)
            if self.core.syncs > syncs or self.core.state is State.INJECTING:
                syncs, heard_s = self.core.syncs, self._loop.time()
            elif self._loop.time() - heard_s > self._silence_s:
                parts = self._parts
                self._ending.fail(
                    BusError(silent(parts.config, parts.mapping.sync_message, self._silence_s))
                )
            if self._show is not None:
                self._show(self.core)
            if self.fault is not None or self._over():
                self._ending.ask()

    def _send(self, frames: list[Frame], decided_ns: int) -> None:
        """One by one, now or never."""
        for frame in frames:
            if self._port is None or self._only_listens:
                return
            late_ns = time.monotonic_ns() - decided_ns
            if self.core.command.enable and late_ns > _LATE_NS:
                why = f"the command was {late_ns * 1e-6:.0f} ms late on its way to the bus"
                self.core.override.trip(time.monotonic_ns(), Trip.CLOCK, why)
                return
            try:
                sent = self._port.send(frame)
            except BusError as error:
                self._lost(str(error))
                return
            self.core.on_sent(time.monotonic_ns(), frame, sent)

    def _record(self) -> None:
        transitions = self.core.override.take_transitions()
        for transition in transitions:
            self._unwritten.append((transition, time.time_ns()))
            if transition.after is State.FAULT and transition.before is not State.FAULT:
                self.fault = transition
        self._write()
        for transition in transitions:
            self._tell(f"override   {transition}")

    def _tell(self, line: str) -> None:
        """To a person, who may be gone: what ended a session must come out all the same."""
        with contextlib.suppress(OSError):
            self._say(line)

    def _write(self) -> None:
        """Into the journal, in order; a disk that refuses ends the session, but loses nothing."""
        try:
            while self._unwritten:
                transition, wall_ns = self._unwritten[0]
                self._journal.write([transition], wall_ns)
                self._unwritten.popleft()
        except OSError as error:
            self._ending.fail(error)

    # Ends.

    def _lost(self, reason: str) -> None:
        if self._port is None:
            return
        self.core.override.trip(time.monotonic_ns(), Trip.BUS, reason)
        port, self._port = self._port, None
        port.close()
        self._ending.fail(BusError(f"{self._parts.config.bus}: the bus is lost: {reason}"))

    def _tear_down(self) -> None:
        """Release, say so on the bus, and write it down; in this order."""
        try:
            fault = self._abnormal or self._ending.failure is not None
            self._send_last(self.core.end(time.monotonic_ns(), self._why, fault=fault))
            for _ in range(_LAST_TRIES):
                if self._port is None or not (last := self.core.owed(1)):
                    break
                time.sleep(_LAST_WAIT_S)
                self._send_last(last)
        finally:
            port, self._port = self._port, None
            try:
                if port is not None:
                    port.close()
            except Exception as error:  # what happened is written down all the same
                self._ending.fail(error)
            self._record()
            if self._unwritten:
                lacking = ", ".join(str(each) for each, _ in self._unwritten)
                self._tell(f"override   the journal could not be written and lacks: {lacking}")

    def _send_last(self, frames: list[Frame]) -> None:
        """An error of a driver keeps the next release from nothing."""
        try:
            self._send(frames, time.monotonic_ns())
        except Exception as error:  # whatever its vendor's library raises
            self._ending.fail(error)

    def _on_error(self, error: BaseException) -> None:
        self._why = f"{type(error).__name__}: {error}"

    @contextlib.contextmanager
    def _signals(self) -> Iterator[None]:
        """SIGINT, SIGTERM, SIGHUP: zero, release, recorded; the second one ends the process.

        Not a second SIGHUP: where a terminal goes, shell and kernel send one each.
        """
        caught = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]

        def stop(number: signal.Signals) -> None:
            self._why, self._abnormal = f"{number.name}", True
            self._ending.ask()
            if number != signal.SIGHUP:
                self._loop.remove_signal_handler(number)
                signal.signal(number, signal.SIG_DFL)

        try:
            for number in caught:
                self._loop.add_signal_handler(number, stop, number)
        except (RuntimeError, ValueError):  # not in the main thread: its owner has the signals
            caught = []
        try:
            yield
        finally:
            for number in caught:
                self._loop.remove_signal_handler(number)
