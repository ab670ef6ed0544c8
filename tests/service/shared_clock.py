"""A session on a real bus by a clock of the test, for machines that keep no time.

The rig's millisecond is the clock's millisecond, and none begins before the session has taken the
frames of the last one: a guest that stands still for 100 ms makes the test longer, nothing else.
What real time does to a session is shown by test_override_kill.py and on UDP.
"""

import asyncio
import threading
import time
from collections.abc import Sequence
from dataclasses import replace

from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Deliver, OnLost, Port, PortCounts
from eps_hil.service.operator import Desk

_T0_NS, _WALL0_NS = 5_000_000_000_000, 1_790_000_000_000_000_000
_PATIENCE_S = 60.0


class SharedClock:
    """Stands in for the module ``time`` where the session reads its clocks."""

    def __init__(self) -> None:
        self.spent_ns = 0

    def monotonic_ns(self) -> int:
        return _T0_NS + self.spent_ns

    def time_ns(self) -> int:
        return _WALL0_NS + self.spent_ns

    def sleep(self, seconds: float) -> None:
        """Of real time: a real queue is waited for."""
        time.sleep(seconds)


class StampedPort:
    """A port whose frames carry the clock's time; knows which frame its owner took last."""

    def __init__(self, port: Port, clock: SharedClock) -> None:
        self._port, self.name, self._clock = port, port.name, clock
        self._taken = threading.Condition()
        self._last: tuple[int, bytes] | None = None
        self._reads = False

    @property
    def counts(self) -> PortCounts:
        return self._port.counts

    @property
    def state(self) -> BusState:
        return self._port.state

    def start(
        self, loop: asyncio.AbstractEventLoop, deliver: Deliver, on_lost: OnLost | None = None
    ) -> None:
        def stamped(frames: list[Frame]) -> None:
            deliver([replace(frame, t_ns=self._clock.time_ns()) for frame in frames])
            self._tell((frames[-1].can_id, frames[-1].data), True)

        self._reads = True
        self._port.start(loop, stamped, on_lost)

    def send(self, frame: Frame) -> bool:
        return self._port.send(frame)

    def recv(self, timeout_s: float) -> list[Frame]:
        return self._port.recv(timeout_s)

    def close(self) -> None:
        self._port.close()
        self._tell(self._last, False)

    def answers(self, frames: Sequence[Frame], receive_ids: Sequence[int]) -> bool:
        """Wait until the owner has taken the last one that it listens to; False: it is gone."""
        wanted = [(f.can_id, f.data) for f in frames if f.can_id in receive_ids]
        with self._taken:
            if wanted:
                self._taken.wait_for(
                    lambda: not self._reads or self._last == wanted[-1], _PATIENCE_S
                )
            return self._reads

    def _tell(self, last: tuple[int, bytes] | None, reads: bool) -> None:
        with self._taken:
            self._last, self._reads = last, reads
            self._taken.notify_all()


class PromptOperator:
    """Nobody at the keys, like ``Unattended``, but by the clock of the test."""

    def __init__(self, clock: SharedClock) -> None:
        self._clock = clock
        self._task: asyncio.Task[None] | None = None

    def start(self, loop: asyncio.AbstractEventLoop, desk: Desk) -> None:
        self._task = loop.create_task(self._act(desk))

    async def _act(self, desk: Desk) -> None:
        while not (desk.prepare() and await self._pause(300) and desk.arm()):
            await self._pause(300)
        while True:
            desk.heartbeat()
            await self._pause(20)

    async def _pause(self, milliseconds: int) -> bool:
        end_ns = self._clock.spent_ns + milliseconds * 1_000_000
        while self._clock.spent_ns < end_ns:
            await asyncio.sleep(0.0005)
        return True

    def stop(self) -> None:
        if self._task is not None:
            self._task.cancel()
