"""The monitor on a bus: one more listener, in a process of its own, on a port that cannot send."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from eps_hil.bus.config import BusConfig
from eps_hil.bus.port import Port, open_port
from eps_hil.bus.reconnecting_port import ReconnectingPort
from eps_hil.bus.recorder import with_room
from eps_hil.errors import BusError
from eps_hil.monitor.figures import Figures
from eps_hil.monitor.view_model import Monitor

_WAIT_S = 0.05
Show = Callable[[Figures, list[tuple[str, bool]]], bool]
"""Is given the figures and the alarms that went on or off; True ends the run."""


@dataclass(frozen=True, slots=True)
class Pace:
    """A view each ``period_s``, the last after ``seconds``."""

    period_s: float
    seconds: float


def listen_only(bus: BusConfig) -> Port:
    """The bus of a configuration, all its ids, and none that could be sent."""
    port = open_port(
        bus.interface, bus.channel, fd=bus.fd, receive_ids=None, send_ids=(), options=bus.options
    )
    return with_room(port)  # who only looks may have to wait for seconds on a busy machine


def watch(
    monitor: Monitor,
    port: ReconnectingPort | Port,
    pace: Pace,
    show: Show,
    stop: Callable[[], bool] = lambda: False,
) -> Figures:
    """Until ``stop``, ``seconds`` or ``show`` says so; closes the port. The last figures."""
    begin_s = time.monotonic()
    next_s, end_s = begin_s + pace.period_s, begin_s + pace.seconds
    try:
        while True:
            now_s = time.monotonic()
            over = stop() or now_s >= end_s
            if now_s < next_s and not over:
                monitor.take(port.recv(min(_WAIT_S, next_s - now_s)))
                continue
            monitor.take(port.recv(0.0))
            figures = monitor.figures(time.time_ns(), port.counts, port.state)
            if show(figures, monitor.changes) or over:
                return figures
            next_s = max(next_s + pace.period_s, time.monotonic())
    finally:
        port.close()


def open_watched(bus: BusConfig, say: Callable[[str], None]) -> ReconnectingPort | Port:
    """A port that outlives its bus where the configuration asks for it (``bus.reconnect``)."""
    if bus.reconnect:
        return ReconnectingPort(lambda: listen_only(bus), say, name=str(bus))
    return listen_only(bus)


def heard_nothing(figures: Figures) -> BusError:
    """What ``--once`` says of a silent bus."""
    return BusError(f"{figures.bus.name}: no frame came; is the rig on this bus?")
