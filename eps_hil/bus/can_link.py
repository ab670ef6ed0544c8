"""What the kernel knows of a CAN controller's state, and how to restart one that is bus-off.

Error frames tell only of changes, and one may be lost; the state itself is in the link's details
(rtnetlink, linux/can/netlink.h), which is where ``ip -details link show can0`` has it from.
"""

import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from eps_hil.bus.port import BusState

# linux/netlink.h, linux/rtnetlink.h, linux/if_link.h, linux/can/netlink.h
_NETLINK_ROUTE, _NLM_REQUEST, _NLM_ACK = 0, 0x1, 0x4
_NLMSG_ERROR, _RTM_NEWLINK, _RTM_GETLINK = 2, 16, 18
_IFLA_LINKINFO, _INFO_KIND, _INFO_DATA = 18, 1, 2
_CAN_STATE, _CAN_RESTART_MS, _CAN_RESTART = 4, 6, 7
_STATES = (
    BusState.ERROR_ACTIVE, BusState.ERROR_WARNING, BusState.ERROR_PASSIVE, BusState.BUS_OFF,
)  # fmt: skip
_WITHOUT_CONTROLLER = frozenset({"vcan", "vxcan"})
_HEADER, _LINK, _ATTRIBUTE = struct.Struct("=IHHII"), struct.Struct("=BBHiII"), struct.Struct("=HH")
_TIMEOUT_S = 0.2


@dataclass(frozen=True, slots=True)
class CanLink:
    """``kind``: ``can``, ``vcan``, ...; ``restarts_itself``: the kernel ends bus-off (restart-ms).

    A virtual bus has no controller and so no errors: its state is error active while it is up.
    """

    kind: str
    state: BusState
    restarts_itself: bool

    @property
    def virtual(self) -> bool:
        """Whether there is no controller behind it."""
        return self.kind in _WITHOUT_CONTROLLER


def can_link(channel: str) -> CanLink | None:
    """Ask the kernel; None where it does not say (no such interface, no rtnetlink)."""
    try:
        answer = _talk(_RTM_GETLINK, _NLM_REQUEST, socket.if_nametoindex(channel))
    except OSError:
        return None
    return read_link(answer)


def restart(channel: str) -> bool:
    """Restart a controller that is bus-off, as ``ip link set can0 type can restart`` does.

    False where that is not permitted (CAP_NET_ADMIN) or not possible.
    """
    data = _attribute(_CAN_RESTART, struct.pack("=I", 1))
    details = _attribute(_INFO_KIND, b"can\0") + _attribute(_INFO_DATA, data)
    try:
        index = socket.if_nametoindex(channel)
        flags = _NLM_REQUEST | _NLM_ACK
        answer = _talk(_RTM_NEWLINK, flags, index, _attribute(_IFLA_LINKINFO, details))
    except OSError:
        return False
    kind, (error,) = _HEADER.unpack_from(answer)[1], struct.unpack_from("=i", answer, _HEADER.size)
    return bool(kind == _NLMSG_ERROR and error == 0)


def read_link(answer: bytes) -> CanLink | None:
    """The link that an RTM_NEWLINK message describes; None if it is none of CAN."""
    if len(answer) < _HEADER.size + _LINK.size or _HEADER.unpack_from(answer)[1] != _RTM_NEWLINK:
        return None
    found = dict(_attributes(answer[_HEADER.size + _LINK.size :]))
    details = dict(_attributes(found.get(_IFLA_LINKINFO, b"")))
    kind = details.get(_INFO_KIND, b"").rstrip(b"\0").decode("ascii", "replace")
    if kind in _WITHOUT_CONTROLLER:
        return CanLink(kind, BusState.ERROR_ACTIVE, True)
    data = dict(_attributes(details.get(_INFO_DATA, b"")))
    if _CAN_STATE not in data:
        return None
    (number,) = struct.unpack_from("=I", data[_CAN_STATE])
    (restart_ms,) = struct.unpack_from("=I", data.get(_CAN_RESTART_MS, bytes(4)))
    state = _STATES[number] if number < len(_STATES) else BusState.UNKNOWN
    return CanLink(kind, state, restart_ms > 0)


def _talk(kind: int, flags: int, index: int, attributes: bytes = b"") -> bytes:
    body = _LINK.pack(socket.AF_UNSPEC, 0, 0, index, 0, 0) + attributes
    message = _HEADER.pack(_HEADER.size + len(body), kind, flags, 1, 0) + body
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_ROUTE) as kernel:
        kernel.settimeout(_TIMEOUT_S)
        kernel.send(message)
        return kernel.recv(1 << 16)


def _attribute(kind: int, value: bytes) -> bytes:
    length = _ATTRIBUTE.size + len(value)
    return _ATTRIBUTE.pack(length, kind) + value + bytes(-length % 4)


def _attributes(data: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at + _ATTRIBUTE.size <= len(data):
        length, kind = _ATTRIBUTE.unpack_from(data, at)
        if length < _ATTRIBUTE.size or at + length > len(data):
            return
        yield kind & 0x3FFF, data[at + _ATTRIBUTE.size : at + length]
        at += length + -length % 4
