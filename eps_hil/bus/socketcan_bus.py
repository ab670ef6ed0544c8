"""Our SocketCAN socket as a python-can bus, for scripts and tools that are written for those.

with SocketCanBus("vcan0") as bus: ...          # or can.Bus(interface="eps_hil", ...)
"""

from collections import deque
from typing import Any

import can

from eps_hil.bus.frame import Frame
from eps_hil.bus.python_can import from_message, to_message
from eps_hil.bus.socketcan import SocketCanPort
from eps_hil.errors import BusError


class SocketCanBus(can.BusABC):  # type: ignore[misc,unused-ignore]
    """:class:`~eps_hil.bus.socketcan.SocketCanPort` behind python-can's interface."""

    def __init__(
        self,
        channel: str = "vcan0",
        *,
        fd: bool = False,
        receive_own_messages: bool = False,
        can_filters: Any = None,
        **options: Any,
    ) -> None:
        """``options`` are those of the port; :class:`can.CanInitializationError` if refused."""
        try:
            self.port = SocketCanPort(channel, fd=fd, receive_own=receive_own_messages, **options)
        except BusError as error:
            raise can.CanInitializationError(str(error)) from error
        self._pending: deque[Frame] = deque()
        self._interface = channel
        self.channel_info = f"eps_hil socketcan '{channel}'"
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        super().__init__(channel=channel, can_filters=can_filters)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        while not self._pending:
            try:
                self._pending.extend(self.port.recv(1.0 if timeout is None else timeout))
            except BusError as error:
                raise can.CanOperationError(str(error)) from error
            if timeout is not None:
                break
        if not self._pending:
            return None, False
        return to_message(self._pending.popleft(), self._interface), False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send now; :class:`can.CanOperationError` when the queue is full or the bus gone."""
        try:
            accepted = self.port.send(from_message(msg, 0))
        except BusError as error:
            raise can.CanOperationError(str(error)) from error
        if not accepted:
            raise can.CanOperationError(f"{self.port.name}: the transmit queue is full")

    def shutdown(self) -> None:
        """Close the socket."""
        super().shutdown()
        self.port.close()
