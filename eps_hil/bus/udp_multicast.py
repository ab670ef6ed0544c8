"""CAN over UDP multicast: python-can's ``udp_multicast`` wire format, by a socket of our own.

The bus for machines whose kernel has no CAN. Any python-can program on the same group and port
is a peer. python-can's own class is not used, because a bus opened with it receives what it
sends (``receive_own_messages`` is not implemented there), stamps in float seconds, and does not
say what the kernel dropped. Here a second socket sends, so that our frames are known by their
source port; and where there is no route for multicast (no network at all), loopback is used.
"""

import contextlib
import ipaddress
import socket
import struct
import time
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import msgpack

from eps_hil.bus.commands import OWN
from eps_hil.bus.envelopes import Envelopes
from eps_hil.bus.frame import EXTENDED_ID_MAX, STANDARD_ID_MAX, Frame, frame_of
from eps_hil.bus.port import BusState, Port, SendRule
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
_DOUBLE = struct.Struct(">d")
_ENVELOPES: dict[tuple[object, int], tuple[bytes, bytes, bytes]] = {}
_ENVELOPES_MAX = 1_000
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
        never_send_ids: Collection[int] = tuple(OWN),
        port: int = DEFAULT_PORT,
        hop_limit: int = 1,
        receive_buffer_bytes: int = RECEIVE_BUFFER_BYTES,
    ) -> None:
        """Join ``channel`` (an IPv4 or IPv6 multicast address).

        ``hop_limit`` 0 keeps the frames on this machine, 1 on the local network. A smaller
        receive buffer than asked for is taken as it is: loss is counted, and a machine without
        CAN serves for trying things out. :class:`BusError` if the group cannot be joined.
        """
        name = f"udp_multicast:{channel}:{port}"
        rule = SendRule(name, send_ids, never_send_ids)
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
        self._envelopes = Envelopes()
        self._group = family, channel
        super().__init__(name, receiver, rule)
        self._state = BusState.ERROR_ACTIVE  # no controller, so no errors: up until it is lost

    def close(self) -> None:
        """Leave the group and close both sockets."""
        super().close()
        self._sender.close()

    def _when_silent(self) -> None:
        """A network interface that was made anew has forgotten the group: join it again."""
        _join(self._sock, *self._group, again=True)

    def _parse(
        self, data: bytes, t_ns: int, hardware_ns: int, flags: int, address: Any
    ) -> Frame | None:
        if address[1] == self._own_address[1] and address[:2] == self._own_address:
            return None
        found = self._envelopes.look(data)
        if found is not None:
            kind, payload = found
            if not kind.wanted:
                return None
            return frame_of(
                t_ns, kind.can_id, payload, kind.extended, kind.fd, False, False, False, kind.brs
            )
        frame = self._unpack(data, t_ns)
        if frame is None:
            return None
        if frame.error:
            self._errors += 1
            return frame
        unwanted = self._receive_ids is not None and frame.can_id not in self._receive_ids
        unwanted |= frame.fd and not self._fd
        self._envelopes.learn(data, frame, not unwanted)
        return None if unwanted else frame

    def _unpack(self, data: bytes, t_ns: int) -> Frame | None:
        try:
            fields = msgpack.unpackb(data)
            remote = bool(fields["is_remote_frame"])
            can_id, payload = fields["arbitration_id"], b"" if remote else fields["data"] or b""
            extended, fd = bool(fields["is_extended_id"]), bool(fields["is_fd"])
            error = bool(fields["is_error_frame"])
            most = EXTENDED_ID_MAX if extended or error else STANDARD_ID_MAX
            fits = isinstance(can_id, int) and 0 <= can_id <= most
            if not fits or not isinstance(payload, bytes) or len(payload) > (64 if fd else 8):
                raise ValueError("no CAN bus carries that")
            return frame_of(
                t_ns,
                can_id,
                payload,
                extended,
                fd,
                error,
                False,
                remote,
                bool(fields["bitrate_switch"]),
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

    def _transmit(self, frame: Frame) -> None:
        if frame.fd and not self._fd:
            raise BusError("a CAN FD frame on a port without FD; open it with fd: true")
        self._sender.send(encode(frame))


def encode(frame: Frame) -> bytes:
    """One frame as python-can's ``udp_multicast`` writes it (a msgpack map of ``can.Message``)."""
    kind = frame.can_id, frame.extended, frame.remote, frame.error, frame.fd, frame.brs
    size = len(frame.data)
    found = _ENVELOPES.get((kind, size))
    if found is None:
        if len(_ENVELOPES) > _ENVELOPES_MAX:
            _ENVELOPES.clear()
        found = _ENVELOPES[kind, size] = _envelope(frame)
    before, between, after = found
    return b"".join((before, _DOUBLE.pack(time.time()), between, frame.data, after))


def _envelope(frame: Frame) -> tuple[bytes, bytes, bytes]:
    """What is the same in all frames of one id and length: around the time, and around the data."""
    first = {"timestamp": 0.0}
    middle = {
        "arbitration_id": frame.can_id,
        "is_extended_id": frame.extended,
        "is_remote_frame": frame.remote,
        "is_error_frame": frame.error,
        "channel": None,
        "dlc": len(frame.data),
        "data": frame.data,
    }
    last = {
        "is_fd": frame.fd,
        "bitrate_switch": frame.brs,
        "error_state_indicator": False,
    }
    fields = len(first) + len(middle) + len(last)
    head = msgpack.Packer().pack_map_header(fields) + msgpack.packb(first)[1:-8]
    body, tail = msgpack.packb(middle)[1:], msgpack.packb(last)[1:]  # their own headers left out
    return head, body[: len(body) - len(frame.data)], tail


def open_udp_multicast(
    channel: str,
    *,
    fd: bool,
    receive_ids: Sequence[int] | None,
    send_ids: Sequence[int] | None,
    never_send_ids: Collection[int] = tuple(OWN),
    options: Mapping[str, Any],
) -> Port:
    """:class:`UdpMulticastPort` with options from a configuration file."""
    known = ("hop_limit", "port", "receive_buffer_bytes")
    with options_refused("udp_multicast", channel, options, known):
        return UdpMulticastPort(
            channel,
            fd=fd,
            receive_ids=receive_ids,
            send_ids=send_ids,
            never_send_ids=never_send_ids,
            **options,
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


def _join(
    sock: socket.socket, family: socket.AddressFamily, channel: str, *, again: bool = False
) -> None:
    """Join on the interface of the route and on loopback: peers with and without a network.

    ``again``: leave first, for the kernel may take us for a member where its interface does not.
    """
    group = socket.inet_pton(family, channel)
    if family == socket.AF_INET:
        places = [group + socket.inet_aton(address) for address in ("0.0.0.0", _LOOPBACK)]
        level, leave, enter = (
            socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, socket.IP_ADD_MEMBERSHIP,
        )  # fmt: skip
    else:
        places = [group + struct.pack("@I", index) for index in (0, _LOOPBACK_INDEX)]
        level, leave, enter = socket.IPPROTO_IPV6, socket.IPV6_LEAVE_GROUP, socket.IPV6_JOIN_GROUP
    refused: list[OSError] = []
    for place in places:
        if again:
            with contextlib.suppress(OSError):
                sock.setsockopt(level, leave, place)
        try:
            sock.setsockopt(level, enter, place)
        except OSError as error:
            refused.append(error)
    if len(refused) == len(places):
        raise refused[0]
