"""What the service, the rig and the recorder know of a CAN bus: the ``Port``.

``socketcan`` and ``udp_multicast`` are served by the project's own sockets (``bus/socketcan.py``,
``bus/udp_multicast.py``), every other interface by python-can (``bus/python_can.py``). All count
what they received, sent, dropped and lost.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

from eps_hil.bus.frame import Frame

Deliver = Callable[[list[Frame]], None]
OnLost = Callable[[str], None]


class BusState(StrEnum):
    """State of the CAN controller (ISO 11898-1, fault confinement), as far as it told us."""

    UNKNOWN = "unknown"
    ERROR_ACTIVE = "error_active"
    ERROR_WARNING = "error_warning"
    ERROR_PASSIVE = "error_passive"
    BUS_OFF = "bus_off"
    LOST = "lost"  # the interface or the driver went away


@dataclass(frozen=True, slots=True)
class PortCounts:
    """Frames since the port was opened.

    ``send_dropped``: refused by a full queue (never queued by us); ``lost_in_kernel``: received
    by the machine, but overwritten before we read them (0 where the driver cannot tell).
    """

    received: int = 0
    sent: int = 0
    send_dropped: int = 0
    lost_in_kernel: int = 0
    error_frames: int = 0


class Port(Protocol):
    """One open CAN channel. Use either :meth:`start` (asyncio) or :meth:`recv`, not both."""

    name: str

    @property
    def counts(self) -> PortCounts:
        """A snapshot of the counters."""

    @property
    def state(self) -> BusState:
        """The controller's state by the last error frame, or ``LOST``."""

    def start(
        self, loop: asyncio.AbstractEventLoop, deliver: Deliver, on_lost: OnLost | None = None
    ) -> None:
        """Hand every drained batch, in order, to ``deliver`` in the loop's thread.

        ``on_lost(reason)`` is called once when the bus is gone; nothing is delivered after it.
        """

    def send(self, frame: Frame) -> bool:
        """Send now or not at all: False when dropped (counted). Never queues, never blocks.

        :class:`~eps_hil.errors.BusError` when the bus is gone, or the id is not in ``send_ids``.
        """

    def recv(self, timeout_s: float) -> list[Frame]:
        """All pending frames, waiting up to ``timeout_s`` for the first; [] after that.

        :class:`~eps_hil.errors.BusError` when the bus is gone.
        """

    def close(self) -> None:
        """Stop delivering and release the channel; may be called twice."""


def open_port(
    interface: str,
    channel: str,
    *,
    fd: bool = False,
    receive_ids: Sequence[int] | None = None,
    send_ids: Sequence[int] | None = None,
    options: Mapping[str, Any] | None = None,
) -> Port:
    """Open ``channel`` of ``interface``; :class:`~eps_hil.errors.BusError` in one line if refused.

    ``receive_ids``: only these are received (None: everything); an id of up to 11 bits matches
    in either format. ``send_ids``: the only ids :meth:`Port.send` accepts (None: any; empty:
    listen only). ``options``: keyword arguments of the python-can interface (``bitrate``,
    ``port``, ...), or of :class:`~eps_hil.bus.socketcan.SocketCanPort`.
    """
    chosen = dict(options or {})
    if interface == "socketcan":
        from eps_hil.bus.socketcan import open_socketcan

        return open_socketcan(
            channel, fd=fd, receive_ids=receive_ids, send_ids=send_ids, options=chosen
        )
    if interface == "udp_multicast":
        from eps_hil.bus.udp_multicast import open_udp_multicast

        return open_udp_multicast(
            channel, fd=fd, receive_ids=receive_ids, send_ids=send_ids, options=chosen
        )
    from eps_hil.bus.python_can import PythonCanPort

    return PythonCanPort(
        interface, channel, fd=fd, receive_ids=receive_ids, send_ids=send_ids, options=chosen
    )
