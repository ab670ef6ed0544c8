"""CAN over UDP multicast: python-can's ``udp_multicast`` wire format, by a socket of our own.

The bus for machines whose kernel has no CAN. Any python-can program on the same group and port
is a peer. python-can's own class is not used, because a bus opened with it receives what it
sends (``receive_own_messages`` is not implemented there), stamps in float seconds, and does not
say what the kernel dropped. Here a second socket sends, so that our frames are known by their
source port; and where there is no route for multicast (no network at all), loopback is used.
"""

import ipaddress
import socket
import struct
import time
from collections.abc import Mapping, Sequence
from typing import Any, cast

import msgpack

from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port
from eps_hil.bus.socket_port import (
    RECEIVE_BUFFER_BYTES,
    SocketPort,
    options_refused,
    set_receive_buffer,
    stamp_and_count,
)
from eps_hil.errors import BusError

DEFAULT_PORT = 43113  # python-can's
_LOOPBACK = "127.0.0.1"
_LOOPBACK_INDEX = 1


class UdpMulticastPort(SocketPort):
    """A multicast group as a CAN bus; implements :class:`~eps_hil.bus.port.Port`."""

    def __init__(
        self,
        channel: str,
        *,
        fd: bool = True,
        receive_ids: Sequence[int] | None = None,
        send_ids: Sequence[int] | None = None,
        port: int = DEFAULT_PORT,
        hop_limit: int = 1,
        receive_buffer_bytes: int = RECEIVE_BUFFER_BYTES,
    ) -> None:
        """Join ``channel`` (an IPv4 or IPv6 multicast address).

        ``hop_limit`` 0 keeps the frames on this machine, 1 on the local network. A smaller
        receive buffer than asked for is taken as it is: loss is counted, and a machine without
        CAN serves for trying things out. :class:`BusError` if the group cannot be joined.
        """
        family = _family(channel)
        self._fd = fd
        self._receive_ids = None if receive_ids is None else frozenset(receive_ids)
        self.malformed = 0  # datagrams that were not CAN frames; never a reason to stop
        sender = _sender(family, channel, port, hop_limit)
        try:
            receiver = _receiver(family, channel, port, receive_buffer_bytes)
        except BusError:
            sender.close()
            raise
        self._sender = sender
        self._own_address = sender.getsockname()[:2]
        super().__init__(f"udp_multicast:{channel}:{port}", receiver, send_ids)

    def close(self) -> None:
        """Leave the group and close both sockets."""
        super().close()
        self._sender.close()

    def _parse(
        self, data: bytes, t_ns: int, hardware_ns: int, flags: int, address: Any
    ) -> Frame | None:
        if address[:2] == self._own_address:
            return None
        try:
            fields = msgpack.unpackb(data)
            can_id = fields["arbitration_id"]
            payload = fields["data"]
            frame = Frame(
                t_ns=t_ns,
                can_id=int(can_id),
                data=bytes(payload) if payload else b"",
                extended=bool(fields["is_extended_id"]),
                fd=bool(fields["is_fd"]),
                error=bool(fields["is_error_frame"]),
                remote=bool(fields["is_remote_frame"]),
                brs=bool(fields["bitrate_switch"]),
            )
        except (
            ValueError,
            TypeError,
            KeyError,
            AttributeError,
            msgpack.exceptions.UnpackException,
        ):
            self.malformed += 1
            return None
        if frame.error:
            self._errors += 1
        elif self._receive_ids is not None and frame.can_id not in self._receive_ids:
            return None
        return None if frame.fd and not self._fd else frame

    def _transmit(self, frame: Frame) -> None:
        if frame.fd and not self._fd:
            raise BusError("a CAN FD frame on a port without FD; open it with fd: true")
        self._sender.send(encode(frame))


def encode(frame: Frame) -> bytes:
    """One frame as python-can's ``udp_multicast`` writes it (a msgpack map of ``can.Message``)."""
    message = {
        "timestamp": time.time(),
        "arbitration_id": frame.can_id,
        "is_extended_id": frame.extended,
        "is_remote_frame": frame.remote,
        "is_error_frame": frame.error,
        "channel": None,
        "dlc": len(frame.data),
        "data": frame.data,
        "is_fd": frame.fd,
        "bitrate_switch": frame.brs,
        "error_state_indicator": False,
    }
    return cast(bytes, msgpack.packb(message))


def open_udp_multicast(
    channel: str,
    *,
    fd: bool,
    receive_ids: Sequence[int] | None,
    send_ids: Sequence[int] | None,
    options: Mapping[str, Any],
) -> Port:
    """:class:`UdpMulticastPort` with options from a configuration file."""
    known = ("hop_limit", "port", "receive_buffer_bytes")
    with options_refused("udp_multicast", channel, options, known):
        return UdpMulticastPort(
            channel, fd=fd, receive_ids=receive_ids, send_ids=send_ids, **options
        )


def _family(channel: str) -> socket.AddressFamily:
    try:
        address = ipaddress.ip_address(channel)
    except ValueError:
        address = None
    if address is None or not address.is_multicast:
        raise BusError(
            f"udp_multicast: channel '{channel}' is not a multicast address; "
            "use one such as 239.74.163.2"
        )
    return socket.AF_INET if address.version == 4 else socket.AF_INET6


def _sender(family: socket.AddressFamily, channel: str, port: int, hop_limit: int) -> socket.socket:
    sock = socket.socket(family, socket.SOCK_DGRAM)
    try:
        sock.setblocking(False)
        if family == socket.AF_INET:
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, hop_limit)
        else:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, hop_limit)
        try:
            sock.connect((channel, port))
        except OSError:  # no route: this machine alone
            _send_by_loopback(sock, family)
            sock.connect((channel, port))
    except OSError as error:
        sock.close()
        raise BusError(
            f"udp_multicast: cannot send to {channel} port {port}: {error.strerror}; "
            "sudo ip link set lo up"
        ) from None
    return sock


def _send_by_loopback(sock: socket.socket, family: socket.AddressFamily) -> None:
    if family == socket.AF_INET:
        interface = socket.inet_aton(_LOOPBACK)
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
    else:
        sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, _LOOPBACK_INDEX)


def _receiver(
    family: socket.AddressFamily, channel: str, port: int, buffer_bytes: int
) -> socket.socket:
    sock = socket.socket(family, socket.SOCK_DGRAM)
    try:
        for option in (socket.SO_REUSEADDR, socket.SO_REUSEPORT):  # both, as python-can's peers
            sock.setsockopt(socket.SOL_SOCKET, option, 1)
        stamp_and_count(sock, "udp_multicast")
        set_receive_buffer(sock, buffer_bytes)
        sock.bind((channel, port))
        _join(sock, family, channel)
    except OSError as error:
        sock.close()
        remedy = "choose another port" if port else "name a port"
        raise BusError(
            f"udp_multicast: cannot listen to {channel} port {port}: {error.strerror}; {remedy}"
        ) from None
    except BusError:
        sock.close()
        raise
    return sock


def _join(sock: socket.socket, family: socket.AddressFamily, channel: str) -> None:
    """Join on the interface of the route and on loopback: peers with and without a network."""
    group = socket.inet_pton(family, channel)
    if family == socket.AF_INET:
        places = [group + socket.inet_aton(address) for address in ("0.0.0.0", _LOOPBACK)]
        level, option = socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP
    else:
        places = [group + struct.pack("@I", index) for index in (0, _LOOPBACK_INDEX)]
        level, option = socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP
    refused: list[OSError] = []
    for place in places:
        try:
            sock.setsockopt(level, option, place)
        except OSError as error:
            refused.append(error)
    if len(refused) == len(places):
        raise refused[0]
