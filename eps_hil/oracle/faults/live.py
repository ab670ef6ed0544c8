"""The same faults on a real bus: the real service on real sockets, its clock that of the case.

What :mod:`eps_hil.oracle.faults.drive` imitates is there: two sockets, the kernel's queue between
them, the service's event loop in a thread, its port, its reconnecting. Only time is the case's: a
frame carries the stamp that the case gives it, and the next millisecond begins when the service has
answered the last one. So a machine that stands still for 100 ms makes a case longer, and no
verdict of it another one.
"""

import asyncio
import contextlib
import errno
import select
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

from eps_hil.bus.config import BusConfig
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Deliver, OnLost, Port, PortCounts, open_port
from eps_hil.errors import BusError
from eps_hil.oracle.faults.drive import Enough
from eps_hil.oracle.faults.scene import ALL, Scene
from eps_hil.oracle.faults.stretch import MS, Item, Stretch
from eps_hil.oracle.faults.traffic import Published, World
from eps_hil.service.core import ServiceCore
from eps_hil.service.loop import Service, open_for
from eps_hil.service.present import Present
from eps_hil.service.setup import Parts

PATIENCE_S = 60.0
"""Real time for the service to answer one millisecond of frames."""
_HANDLED_NS = 60_000
_FRAME_NS = 120_000
_RECONNECT_S = 0.05
_FOREIGN = (0x10, 0x55, 0x7F, 0x3AB)

Key = tuple[int, bytes]


class LiveError(Exception):
    """The service did not answer, or its run ended by itself."""


@dataclass(slots=True)
class Clock:
    """True time of the case, and the wall clock that it makes of it."""

    stretch: Stretch
    at: int

    def wall(self) -> int:
        """CLOCK_REALTIME of the service."""
        return self.stretch.wall(self.at)

    def steady(self) -> int:
        """CLOCK_MONOTONIC of the service."""
        return self.at


class CasePort:
    """The service's port: real, but for the stamps; says what its owner has taken."""

    def __init__(self, port: Port, stage: "LiveBus") -> None:
        self._port, self._stage, self.name = port, stage, port.name
        self._transmit = port._transmit  # type: ignore[attr-defined]
        port._transmit = self._full_or_not  # type: ignore[attr-defined]

    @property
    def counts(self) -> PortCounts:
        """See :class:`~eps_hil.bus.port.Port`."""
        return self._port.counts

    @property
    def state(self) -> BusState:
        """See :class:`~eps_hil.bus.port.Port`."""
        return self._port.state

    def start(
        self, loop: asyncio.AbstractEventLoop, deliver: Deliver, on_lost: OnLost | None = None
    ) -> None:
        """See :class:`~eps_hil.bus.port.Port`."""

        def stamped(frames: list[Frame]) -> None:
            deliver([self._stage.stamped(frame) for frame in frames])
            self._stage.took(frames)

        self._port.start(loop, stamped, on_lost)

    def send(self, frame: Frame) -> bool:
        """See :class:`~eps_hil.bus.port.Port`."""
        sent = self._port.send(frame)
        self._stage.answers += sent and frame.can_id == self._stage.estimate_id
        return sent

    def recv(self, timeout_s: float) -> list[Frame]:
        """See :class:`~eps_hil.bus.port.Port`."""
        return self._port.recv(timeout_s)

    def close(self) -> None:
        """See :class:`~eps_hil.bus.port.Port`."""
        self._port.close()

    def fileno(self) -> int:
        """Of the socket."""
        return self._port.fileno()  # type: ignore[attr-defined]

    def _full_or_not(self, frame: Frame) -> None:
        if self._stage.full:
            raise OSError(errno.ENOBUFS, "No buffer space available")
        self._transmit(frame)


class LiveBus:
    """One bus, on which :meth:`drive` stands in for the imitation of the same name.

    ``link`` (``"up"`` or ``"down"``): sets the interface, for :meth:`interface_down_and_up`.
    """

    def __init__(self, bus: BusConfig, link: Callable[[str], None] | None = None) -> None:
        self._bus, self._link = bus, link
        self.outages: list[tuple[int, int]] = []
        """When the interface is down, in true time of the next case."""
        self.full = False
        """Whether the send queue is."""
        self.answers = self.estimate_id = 0
        self._clock = Clock(Stretch(0, 0, []), 0)
        self._stamps: dict[Key, int] = {}
        self._last: Key | None = None
        self._taken = threading.Condition()
        self._ports: list[CasePort] = []

    # Faults that only a real bus can have.

    def interface_down_and_up(self, scene: Scene, since: int, until: int) -> tuple[str, int]:
        """The network interface is set down and up again."""
        self.outages.append((since, until))
        scene.change(ALL, since, until, lambda item: None)
        return "the interface is down", until

    @staticmethod
    def full_load_of_foreign_ids(scene: Scene, since: int, until: int) -> tuple[str, int]:
        """1 Mbit/s, to the last frame: ours come when they are due, in between all others."""
        random, stretch = scene.random, scene.stretch
        made = [
            Item(at, Frame(at, int(random.choice(_FOREIGN)), random.bytes(8)))
            for at in range(since, until, _FRAME_NS)
        ]
        stretch.items = sorted(stretch.items + made, key=lambda item: item.at)
        return f"{len(made)} frames of foreign ids", until

    # The service's side, in its loop's thread.

    def stamped(self, frame: Frame) -> Frame:
        """As the kernel would have stamped it at its time."""
        at = self._stamps.get((frame.can_id, frame.data), self._clock.at)
        return replace(frame, t_ns=self._clock.stretch.wall(at))

    def took(self, frames: list[Frame]) -> None:
        """Answered, all of them."""
        with self._taken:
            self._last = (frames[-1].can_id, frames[-1].data)
            self._taken.notify_all()

    # The case's side.

    def drive(
        self, world: World, core: ServiceCore, stretch: Stretch, enough: Enough | None = None
    ) -> list[Published]:
        """Everything that the service publishes; see :func:`eps_hil.oracle.faults.drive.drive`."""
        self.estimate_id, self._clock = world.reader.can_id, Clock(stretch, stretch.start)
        heard = set(world.parts.decoder.receive_ids) | {self.estimate_id}
        self._stamps.clear()
        self.full, self.answers = False, 0
        sent: list[Published] = []
        asked = stretch.start
        peer = self._open()
        running: _Running | None = _Running(self, world, core)
        outages, self.outages = sorted(self.outages), []
        restarts, stops = sorted(stretch.restarts), sorted(stretch.stops)
        try:
            for now, group in groups(stretch, world.sync_id):
                if outages and now >= outages[0][0]:
                    _, until = outages.pop(0)
                    peer.close()
                    peer = self._outage(until)
                dead = bool(restarts) and restarts[0][0] <= now
                if dead and running is not None:
                    running.end()
                    running = None
                if dead and now >= restarts[0][1]:
                    restarts.pop(0)
                    running = _Running(self, world, world.fresh())
                stopped = bool(stops) and stops[0][0] <= now < stops[0][1]
                if running is not None and not stopped and running.held:
                    self._clock.at = stops.pop(0)[1] + _HANDLED_NS
                    running.go_on()
                    sent += self._published(world, peer, stretch)
                if running is not None and stopped:
                    running.hold()
                self._clock.at = now + _HANDLED_NS
                self.full = any(since <= now < until for since, until in stretch.deaf)
                last = self._send(peer, group, heard)
                if running is None or stopped:
                    continue
                self._wait(running, last)
                sent += self._published(world, peer, stretch)
                if enough is not None and now - asked > 100 * MS:
                    asked = now
                    if enough(sent, now):
                        break
        finally:
            if running is not None:
                running.end()
            peer.close()
        return sent

    def opener(self, parts: Parts) -> Port:
        """The service's port."""
        self._ports.append(CasePort(open_for(parts), self))
        return self._ports[-1]

    def steady_present(self) -> Present:
        """The present by the case's clock."""
        return Present(self._clock.wall, self._clock.steady)

    @property
    def bus(self) -> BusConfig:
        """Which one."""
        return self._bus

    @property
    def port(self) -> CasePort:
        """The service's newest."""
        return self._ports[-1]

    @property
    def openings(self) -> int:
        """How often the service has opened the bus."""
        return len(self._ports)

    def _open(self) -> Port:
        bus = self._bus
        return open_port(bus.interface, bus.channel, fd=bus.fd, options=bus.options)

    def _send(self, peer: Port, group: list[Item], heard: set[int]) -> Key | None:
        last = None
        for item in group:
            key = item.frame.can_id, item.frame.data
            if item.frame.error:
                continue  # made by a controller, not by a sender
            if item.frame.can_id in heard:
                self._stamps[key] = item.at
                last = key
            until_s = time.monotonic() + PATIENCE_S
            while not peer.send(item.frame):
                if time.monotonic() > until_s:
                    raise LiveError("the bus takes no frames")
                time.sleep(0.001)
        return last

    def _wait(self, running: "_Running", last: Key | None) -> None:
        if last is None:
            return
        until_s = time.monotonic() + PATIENCE_S
        with self._taken:
            while self._last != last and not running.over and time.monotonic() < until_s:
                self._taken.wait(0.1)
            done, self._last = self._last == last, None
        if not done:
            raise LiveError(f"the service did not answer: {running.said[-5:]}")

    def _published(self, world: World, peer: Port, stretch: Stretch) -> list[Published]:
        """What has been sent since, and is known to be there."""
        found: list[Frame] = []
        expected, self.answers = self.answers, 0
        until_s = time.monotonic() + PATIENCE_S
        while len(found) < expected and time.monotonic() < until_s:
            found += [f for f in peer.recv(0.05) if f.can_id == self.estimate_id]
        return [world.reader.read(self._clock.at, frame) for frame in found]

    def _outage(self, until: int) -> Port:
        """The interface down, and up again when the service has noticed; then it is back."""
        assert self._link is not None
        openings = self.openings
        self._link("down")
        time.sleep(3 * _RECONNECT_S)
        self._clock.at = until
        self._link("up")
        until_s = time.monotonic() + PATIENCE_S
        while self.openings == openings:
            if time.monotonic() > until_s:
                raise LiveError("the service did not open the bus again")
            time.sleep(0.01)
        time.sleep(_RECONNECT_S)
        return self._open()


def groups(stretch: Stretch, sync_id: int | None) -> Iterator[tuple[int, list[Item]]]:
    """(true time, items) up to a sync frame, or of a millisecond; a case's events in between."""
    waiting: list[Item] = []
    for item in stretch.items:
        if waiting and item.at - waiting[0].at > MS:
            yield waiting[-1].at, waiting
            waiting = []
        waiting.append(item)
        if item.frame.can_id == sync_id:
            yield item.at, waiting
            waiting = []
    if waiting:
        yield waiting[-1].at, waiting


@dataclass
class _Running:
    """A service on its event loop in a thread."""

    stage: LiveBus
    world: World
    core: ServiceCore
    said: list[str] = field(default_factory=list)
    over: bool = False
    held: bool = False

    def __post_init__(self) -> None:
        parts = self.world.parts
        runtime = replace(
            parts.config.service, realtime="off", reconnect_s=_RECONNECT_S, no_input_after_s=1e9
        )
        config = replace(
            parts.config, bus=self.stage.bus, service=runtime,
            publish=replace(parts.config.publish, listen_first_s=0.0),
        )  # fmt: skip
        mine = replace(parts, config=config, core=self.core)
        self.service = Service(
            mine, self._say, opener=self.stage.opener, present=self.stage.steady_present()
        )
        self._ready, self._go = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        if not self._ready.wait(PATIENCE_S) or self.over:
            raise LiveError(f"the service did not start: {self.said}")

    def hold(self) -> None:
        """As SIGSTOP does: the loop stands still, its socket goes on filling."""
        if not self.held:
            self.held = True
            self._go.clear()
            standing = threading.Event()

            def stand() -> None:
                standing.set()
                self._go.wait()

            self._loop.call_soon_threadsafe(stand)
            standing.wait(PATIENCE_S)

    def go_on(self) -> None:
        """As SIGCONT; back when the loop has taken all that waited."""
        self.held = False
        self._go.set()
        until_s = time.monotonic() + PATIENCE_S
        for _ in range(3):
            while self._waits() and time.monotonic() < until_s:
                time.sleep(0.005)
            asyncio.run_coroutine_threadsafe(asyncio.sleep(0), self._loop).result(PATIENCE_S)

    def end(self) -> None:
        """As SIGKILL does to the bus, but for one last frame with status "off"."""
        self._go.set()
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self.service.stop)
        self._thread.join(PATIENCE_S)

    def _waits(self) -> bool:
        return bool(select.select([self.stage.port.fileno()], [], [], 0.0)[0])

    def _say(self, line: str) -> None:
        self.said.append(line)
        if line == "READY":
            self._ready.set()

    def _run(self) -> None:
        async def run() -> None:
            self._loop = asyncio.get_running_loop()
            await self.service.run()

        try:
            asyncio.run(run())
        except (BusError, OSError) as error:
            self.said.append(repr(error))
        finally:
            self.over = True
            self._ready.set()
