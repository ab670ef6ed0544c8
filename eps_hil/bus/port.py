"""What the service, the rig and the recorder know of a CAN bus: the ``Port``.

``socketcan`` and ``udp_multicast`` are served by the project's own sockets (``bus/socketcan.py``,
``bus/udp_multicast.py``), every other interface by python-can (``bus/python_can.py``). All count
what they received, sent, dropped and lost.
"""

import asyncio
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

from eps_hil.bus.commands import OWN
from eps_hil.bus.frame import EXTENDED_ID_MAX, STANDARD_ID_MAX, Frame
from eps_hil.errors import BusError

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


class SendRule:
    """What one port may send. Every port asks it before every frame, so that no program gets
    round it by mistake; ids count by number, whatever their format.

    ``send_ids``: the only ones (None: any); ``never``: refused all the same.
    """

    def __init__(
        self, name: str, send_ids: Collection[int] | None, never: Collection[int] = tuple(OWN)
    ) -> None:
        """:class:`BusError` where the two contradict each other."""
        self._name = name
        self._send_ids = None if send_ids is None else frozenset(send_ids)
        self._never = frozenset(never)
        both = sorted(self._never & (self._send_ids or frozenset()))
        if both:
            raise BusError(f"{name}: {self._commands(both[0])}")

    def check(self, frame: Frame) -> None:
        """:class:`BusError` if this frame may not be sent."""
        can_id = frame.can_id
        if can_id in self._never:
            raise BusError(f"{self._name}: {self._commands(can_id)}")
        if self._send_ids is not None and can_id not in self._send_ids:
            raise BusError(
                f"{self._name}: not configured to send id 0x{can_id:X}; "
                "add it to the ids that this program may send"
            )
        # A driver that cuts bits off would make another id of it, that of a command perhaps.
        wide = frame.extended or frame.error
        if not 0 <= can_id <= (EXTENDED_ID_MAX if wide else STANDARD_ID_MAX):
            raise BusError(f"{self._name}: id 0x{can_id:X} does not fit its format")

    @staticmethod
    def _commands(can_id: int) -> str:
        return f"id 0x{can_id:X} commands a torque or a rig; this program may never send it"


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

        :class:`~eps_hil.errors.BusError` when the bus is gone, or the id is not in ``send_ids``
        or one of ``never_send_ids``.
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
    never_send_ids: Collection[int] = tuple(OWN),
    options: Mapping[str, Any] | None = None,
) -> Port:
    """Open ``channel`` of ``interface``; :class:`~eps_hil.errors.BusError` in one line if refused.

    ``receive_ids``: only these are received (None: everything); an id of up to 11 bits matches
    in either format. ``send_ids``: the only ids :meth:`Port.send` accepts (None: any; empty:
    listen only); ``never_send_ids``: refused even so, by default the commands of the project's
    own database. ``options``: keyword arguments of the python-can interface (``bitrate``,
    ``port``, ...), or of :class:`~eps_hil.bus.socketcan.SocketCanPort`.
    """
    chosen = dict(options or {})
    if interface == "socketcan":
        from eps_hil.bus.socketcan import open_socketcan

        return open_socketcan(
            channel,
            fd=fd,
            receive_ids=receive_ids,
            send_ids=send_ids,
            never_send_ids=never_send_ids,
            options=chosen,
        )
    if interface == "udp_multicast":
        from eps_hil.bus.udp_multicast import open_udp_multicast

        return open_udp_multicast(
            channel,
            fd=fd,
            receive_ids=receive_ids,
            send_ids=send_ids,
            never_send_ids=never_send_ids,
            options=chosen,
        )
    from eps_hil.bus.python_can import PythonCanPort

    return PythonCanPort(
        interface,
        channel,
        fd=fd,
        receive_ids=receive_ids,
        send_ids=send_ids,
        never_send_ids=never_send_ids,
        options=chosen,
    )
