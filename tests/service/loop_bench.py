"""A running service, a tiny rig and a listener on one bus without hardware."""

import asyncio
import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from eps_hil.bus.config import BusConfig
from eps_hil.bus.eager_loop import EagerLoop
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Deliver, OnLost, Port, PortCounts, open_port
from eps_hil.estimation.validity import Reason
from eps_hil.service.config import ServiceConfig
from eps_hil.service.core import Status
from eps_hil.service.estimate_log import EstimateLog
from eps_hil.service.health import Summary
from eps_hil.service.loop import Service, open_for
from eps_hil.service.setup import Parts, prepare
from eps_hil.service.status_line import Snapshot

from .conftest import T0_NS, Receiver, TinyRig

SYNC, ESTIMATE, VERDICT, HEALTH = 0x100, 0x120, 0x121, 0x400
PATIENCE_S = 30.0
"""A stalled guest, or a first compilation, may take so long over what takes milliseconds."""
_LATE_S = 0.02
"""A sender that is late by no more catches up."""
UDP = BusConfig("udp_multicast", "239.74.163.77", fd=True, options={"port": 43177, "hop_limit": 0})


class Tap:
    """The service's port with an ear on both directions, and a plug that can be pulled."""

    def __init__(self, port: Port) -> None:
        self._port, self.name = port, port.name
        self.received: list[Frame] = []
        self.sent: list[Frame] = []
        self._on_lost: OnLost | None = None
        self.closed = False

    @property
    def counts(self) -> PortCounts:
        return self._port.counts

    @property
    def state(self) -> BusState:
        return self._port.state

    def start(
        self, loop: asyncio.AbstractEventLoop, deliver: Deliver, on_lost: OnLost | None = None
    ) -> None:
        def both(frames: list[Frame]) -> None:
            self.received += frames
            deliver(frames)

        self._on_lost = on_lost
        self._port.start(loop, both, on_lost)

    def send(self, frame: Frame) -> bool:
        self.sent.append(frame)
        return self._port.send(frame)

    def recv(self, timeout_s: float) -> list[Frame]:
        return self._port.recv(timeout_s)

    def close(self) -> None:
        self.closed = True
        self._port.close()

    def pull_the_plug(self) -> None:
        assert self._on_lost is not None
        self._on_lost("the interface was removed")

    def estimates(self) -> list[Frame]:
        return [f for f in self.sent if f.can_id == ESTIMATE]


class Bench:
    """A service and a tiny rig on one bus; ``script`` is what the rig does, in a thread."""

    def __init__(self, config: ServiceConfig) -> None:
        self.config = config
        self.parts = prepare(config, Path("c.yaml"))
        self.parts.estimator.warm_up()
        self.taps: list[Tap] = []
        self.said: list[str] = []
        self.shown: list[Snapshot] = []
        self.log: EstimateLog | None = None
        self._rig, self._k, self._start = TinyRig(), 0, -math.inf
        self._last: Frame | None = None
        self._ready = threading.Event()
        bus = config.bus
        self.peer = open_port(bus.interface, bus.channel, fd=bus.fd, options=bus.options)

    def opener(self, parts: Parts) -> Port:
        self.taps.append(Tap(open_for(parts)))
        return self.taps[-1]

    def say(self, line: str) -> None:
        self.said.append(line)
        if line == "READY":
            self._ready.set()

    def wait_ready(self) -> None:
        """For scripts that count on every frame being seen."""
        assert self._ready.wait(PATIENCE_S)

    def drive(self, milliseconds: int) -> None:
        """Frames of so many milliseconds, at their pace, also from one call to the next: a sender
        that slips every time is not believed."""
        start = time.monotonic() - self._k * 1e-3
        if start - self._start < _LATE_S:
            start = self._start
        self._start = start
        for _ in range(milliseconds):
            for frame in self._rig.millisecond(self._k):
                self._last = frame
                while not self.peer.send(frame):
                    time.sleep(1e-3)
            self._k += 1
            time.sleep(max(0.0, start + self._k * 1e-3 - time.monotonic()))

    def drive_until_valid(self, receiver: Receiver, milliseconds: int) -> None:
        """So many, and more until an estimate is valid: after the bunches in which a busy machine
        sends, a sender is believed again after some time only."""
        self.drive(milliseconds)
        begin = time.monotonic()
        while verdicts(receiver, self.taps[-1].estimates()[-1:]) != [(Status.VALID, Reason.FINE)]:
            assert time.monotonic() - begin < PATIENCE_S, "no estimate became valid"
            self.drive(20)

    def drive_when_ready(self, milliseconds: int) -> None:
        """So that the service sees every frame."""
        self.wait_ready()
        self.drive(milliseconds)

    def pause(self, milliseconds: int) -> None:
        """Silence; the rig's time goes on."""
        self._k += milliseconds
        time.sleep(milliseconds * 1e-3)

    def in_loop(self, action: Callable[[], None]) -> None:
        """Do it in the loop's thread, as a port would."""
        self._loop.call_soon_threadsafe(action)

    def arrived(self) -> bool:
        """Whether what was driven last has reached the service, or never will."""
        if not self.taps:
            return True
        tap = self.taps[-1]
        seen = (frame.data for frame in tap.received[-50:])
        return tap.closed or self._last is None or self._last.data in seen

    def run(self, script: Callable[[], None], duration_s: float = 120.0) -> Summary:
        service = Service(
            self.parts, self.say, show=self.shown.append, log=self.log, opener=self.opener
        )
        failure: list[BaseException] = []

        def act() -> None:
            try:
                script()
            except BaseException as error:  # carried over to the test's thread
                failure.append(error)
            finally:
                end = time.monotonic() + PATIENCE_S
                while not self.arrived() and time.monotonic() < end:
                    time.sleep(0.01)
                time.sleep(0.05)  # and its answer is on its way
                self.in_loop(service.stop)

        async def both() -> Summary:
            self._loop = asyncio.get_running_loop()
            thread = threading.Thread(target=act)
            thread.start()
            try:
                return await service.run(duration_s)
            finally:
                await asyncio.to_thread(thread.join)

        try:
            with asyncio.Runner(loop_factory=EagerLoop) as runner:
                return runner.run(both())
        finally:
            self.peer.close()
            assert not failure, failure

    @property
    def tap(self) -> Tap:
        return self.taps[0]


def on_time(received: list[Frame]) -> list[Frame]:
    """The same frames as a bus that keeps time would have stamped them."""
    ours = [frame for frame in received if not frame.own and not frame.error]
    return [
        replace(frame, t_ns=T0_NS + place // 3 * 1_000_000 + place % 3 * 120_000)
        for place, frame in enumerate(ours)
    ]


def replayed(config: ServiceConfig, received: list[Frame]) -> tuple[list[bytes], int]:
    """The same frames through a new core as fast as it takes them; how many steps were valid."""
    core = prepare(config, Path("c.yaml")).core
    return [f.data for frame in received for f in core.on_frames([frame])], core.valid_steps


def verdicts(receiver: Receiver, frames: list[Frame]) -> list[tuple[int, Reason]]:
    read = [receiver.read(f) for f in frames]
    return [(int(r["EstimateStatus"]), Reason(int(r["EstimateReason"]))) for r in read]


def last_verdict(receiver: Receiver, frames: list[Frame]) -> tuple[int, Reason]:
    """Of the last frame that carried an estimate."""
    return verdicts(receiver, [f for f in frames if not silent(receiver, f)][-1:])[0]


def jumped(receiver: Receiver, frames: list[Frame]) -> int:
    """How many frames a receiver misses by their counter (0..15)."""
    counters = [int(receiver.read(frame)["Counter"]) for frame in frames]
    return sum((b - a - 1) % 16 for a, b in pairwise(counters))


def numbers(receiver: Receiver, frame: Frame) -> tuple[float, ...]:
    told = receiver.read(frame)
    return told["RackForceEstimate"], told["FrictionTorque"]


def silent(receiver: Receiver, frame: Frame) -> bool:
    status, reason = verdicts(receiver, [frame])[0]
    return status == Status.OFF or bool(reason & Reason.NO_INPUT)
