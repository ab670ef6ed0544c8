"""The service's bus, coming and going: opened, lost, opened again, closed."""

import asyncio
from collections.abc import Callable

from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Deliver, Port, PortCounts
from eps_hil.bus.reconnecting_port import add_counts
from eps_hil.errors import AbsentBusError, BusError
from eps_hil.service.ending import Ending

_ADVICE = {
    BusState.BUS_OFF: "nothing can be sent or received; check wiring, termination and bit rate; "
    "restarted where permitted (or: ip link set CHANNEL type can restart-ms 100)",
    BusState.ERROR_PASSIVE: "many errors; check wiring, termination and bit rate",
    BusState.ERROR_WARNING: "errors are on the rise",
}


class Link:
    """One bus of one run.

    ``pause_s`` between attempts to open a lost bus again; None: the loss ends the run.
    """

    def __init__(
        self,
        name: object,
        opener: Callable[[], Port],
        deliver: Deliver,
        say: Callable[[str], None],
        pause_s: float | None,
    ) -> None:
        self._name, self._opener, self._deliver, self._say = name, opener, deliver, say
        self._pause_s = pause_s
        self._port: Port | None = None
        self._past = PortCounts()
        self._told = BusState.ERROR_ACTIVE
        self.losses = 0
        """How often the bus was lost."""

    @property
    def lost(self) -> bool:
        """Whether there is no bus at this moment."""
        return self._port is None

    @property
    def state(self) -> BusState:
        """The controller's state, or ``LOST``."""
        return BusState.LOST if self._port is None else self._port.state

    @property
    def counts(self) -> PortCounts:
        """Of all openings together."""
        return self._past if self._port is None else add_counts(self._past, self._port.counts)

    async def open_first(
        self, loop: asyncio.AbstractEventLoop, ending: Ending, on_wait: Callable[[str], None]
    ) -> None:
        """Open; :class:`BusError` says what is wrong.

        An interface that is not there, or down, is waited for where a lost bus is, until the run
        shall end; ``on_wait`` is told what for, again and again.
        """
        said = False
        while not ending.asked_for:
            try:
                self.open(loop, ending)
            except AbsentBusError as error:
                if self._pause_s is None:
                    raise
                if not said:
                    self._say(f"bus absent {error}; waiting for it (bus.reconnect)")
                said = True
                on_wait(str(error))
                await ending.wait(self._pause_s)
            else:
                if said:
                    self._say("bus back   going on")
                return

    def open(self, loop: asyncio.AbstractEventLoop, ending: Ending) -> None:
        """Open now; :class:`BusError` says what is wrong."""
        self._loop, self._ending = loop, ending
        self._port = self._opener()
        self._port.start(loop, self._deliver, self._on_lost)

    def send(self, frame: Frame) -> bool:
        """Hand over to the bus; False where it was dropped, or where there is none."""
        port = self._port
        if port is None or port.state is BusState.BUS_OFF:
            return False
        try:
            return port.send(frame)
        except BusError as error:
            self._on_lost(str(error))
            return False

    def tell_state(self) -> None:
        """Say a change of the controller's state."""
        state = self.state
        if state not in {self._told, BusState.LOST}:
            self._told = state
            advice = f": {_ADVICE[state]}" if state in _ADVICE else ""
            self._say(f"bus state  {state.replace('_', ' ')}{advice}")

    def close(self) -> None:
        """Let go; may be called twice."""
        if self._port is not None:
            port, self._port = self._port, None
            port.close()
            self._past = add_counts(self._past, port.counts)

    def _on_lost(self, reason: str) -> None:
        if self._port is None:
            return
        self.close()
        self.losses += 1
        if self._pause_s is None:
            self._ending.fail(BusError(f"{self._name}: the bus is lost: {reason}"))
            return
        self._say(f"bus lost   {reason}; waiting for it (bus.reconnect)")
        self._reopening = self._ending.task(self._loop, self._reopen(self._pause_s))

    async def _reopen(self, pause_s: float) -> None:
        while not self._ending.asked_for:
            await self._ending.wait(pause_s)
            if self._ending.asked_for:
                return
            try:
                self.open(self._loop, self._ending)
            except (BusError, OSError):
                continue
            self._say("bus back   going on")
            return
