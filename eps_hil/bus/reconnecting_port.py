"""A port that outlives its bus: for programs that poll, and are to be left alone overnight.

An interface that goes down, is taken out and put back, or whose driver is loaded anew leaves its
socket dead for good. Who polls through this port sees a bus that is silent for a while instead:
it is opened again every ``pause_s`` until that works, each loss and return is said, and counted.
"""

import time
from collections.abc import Callable
from dataclasses import astuple, dataclass

from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Port, PortCounts
from eps_hil.errors import AbsentBusError, BusError

PAUSE_S = 1.0


@dataclass(frozen=True, slots=True)
class Outage:
    """A stretch without a bus, in ns since the epoch; ``until_ns`` 0: it is not over."""

    since_ns: int
    until_ns: int
    reason: str


def add_counts(one: PortCounts, other: PortCounts) -> PortCounts:
    """Counts of two ports, one after the other on the same bus."""
    return PortCounts(*(a + b for a, b in zip(astuple(one), astuple(other), strict=True)))


class ReconnectingPort:
    """Polls and sends like a :class:`~eps_hil.bus.port.Port`; neither raises for a lost bus.

    While it is lost, :meth:`recv` returns nothing and :meth:`send` drops (counted). So it is where
    the interface is not there yet, or down, at the first opening; anything else that is wrong
    then, :class:`~eps_hil.errors.BusError` says. ``say`` gets one line for each loss and return.
    """

    def __init__(
        self,
        opener: Callable[[], Port],
        say: Callable[[str], None] = lambda _: None,
        *,
        pause_s: float = PAUSE_S,
        name: str = "bus",
    ) -> None:
        self._opener, self._say, self._pause_s = opener, say, pause_s
        self._port: Port | None = None
        self.name = name
        """Of the port; until there is one, what was given."""
        self.outages: list[Outage] = []
        """Every loss so far, the newest last."""
        self._past, self._dropped = PortCounts(), 0
        self._next_try_s = 0.0
        self._closed = False
        try:
            self._take(opener())
        except AbsentBusError as error:
            self._wait_for_it("bus absent", str(error))

    @property
    def counts(self) -> PortCounts:
        """Of all openings together; what was to be sent meanwhile counts as dropped."""
        now = self._past if self._port is None else add_counts(self._past, self._port.counts)
        return add_counts(now, PortCounts(send_dropped=self._dropped))

    @property
    def state(self) -> BusState:
        """The controller's state, or ``LOST``."""
        return BusState.LOST if self._port is None else self._port.state

    def send(self, frame: Frame) -> bool:
        """Send now or not at all: False when dropped, also for want of a bus (counted).

        :class:`~eps_hil.errors.BusError` for an id that may not be sent, or after :meth:`close`.
        """
        port = self._port
        if port is None:
            self._check_open()
            self._dropped += 1
            return False
        try:
            return port.send(frame)
        except BusError as error:
            if port.state is not BusState.LOST:
                raise
            self._lose(str(error))
            self._dropped += 1
            return False

    def recv(self, timeout_s: float) -> list[Frame]:
        """All pending frames, waiting up to ``timeout_s``; [] also while there is no bus."""
        self._check_open()
        until_s = time.monotonic() + timeout_s
        while self._port is None:
            now_s = time.monotonic()
            if now_s >= self._next_try_s:
                self._try_again()
            elif now_s >= until_s:
                return []
            else:
                time.sleep(min(until_s, self._next_try_s) - now_s)
        try:
            return self._port.recv(max(0.0, until_s - time.monotonic()))
        except BusError as error:
            self._lose(str(error))
            return []

    def close(self) -> None:
        """Release the channel; may be called twice."""
        self._closed = True
        self._let_go()

    def _check_open(self) -> None:
        if self._closed:
            raise BusError(f"{self.name}: the port is closed")

    def _lose(self, reason: str) -> None:
        self._let_go()
        self._wait_for_it("bus lost  ", reason)

    def _wait_for_it(self, what: str, reason: str) -> None:
        self.outages.append(Outage(time.time_ns(), 0, reason))
        self._next_try_s = time.monotonic() + self._pause_s
        self._say(f"{what} {reason}; waiting for it (bus.reconnect)")

    def _take(self, port: Port) -> None:
        self._port, self.name = port, port.name

    def _let_go(self) -> None:
        if self._port is not None:
            port, self._port = self._port, None
            port.close()
            self._past = add_counts(self._past, port.counts)

    def _try_again(self) -> None:
        try:
            self._take(self._opener())
        except (BusError, OSError):
            self._next_try_s = time.monotonic() + self._pause_s
            return
        last = self.outages[-1]
        self.outages[-1] = Outage(last.since_ns, time.time_ns(), last.reason)
        self._say("bus back   going on")
