"""SocketCAN by our own raw socket: nothing the rig relies on is set by "log it and go on".

Every option is set and, where the kernel may give less than asked for, read back; a refusal
stops the start with the option's name and the remedy. References: Documentation/networking/can
of the Linux kernel, linux/can/raw.h, linux/can/error.h.
"""

import errno
import fcntl
import socket
import struct
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from eps_hil.bus.can_link import can_link, restart
from eps_hil.bus.commands import OWN
from eps_hil.bus.frame import EXTENDED_ID_MAX, STANDARD_ID_MAX, Frame, frame_of
from eps_hil.bus.port import BusState, Port, SendRule
from eps_hil.bus.socket_port import (
    RECEIVE_BUFFER_BYTES,
    SO_TIMESTAMPING,
    SocketPort,
    options_refused,
    require_option,
    set_receive_buffer,
    stamp_and_count,
)
from eps_hil.errors import AbsentBusError, BusError

# linux/can.h, linux/can/raw.h: numbers, for a Python that was built without CAN can still import
_AF_CAN, _CAN_RAW, _SOL_CAN_RAW = 29, 1, 101
_CAN_RAW_FILTER, _CAN_RAW_ERR_FILTER, _CAN_RAW_RECV_OWN_MSGS, _CAN_RAW_FD_FRAMES = 1, 2, 4, 5
_EFF_FLAG, _RTR_FLAG, _ERR_FLAG = 0x8000_0000, 0x4000_0000, 0x2000_0000
_ERR_MASK = 0x1FFF_FFFF
_FILTERS_MAX = 512  # CAN_RAW_FILTER_MAX
_FDF_BRS, _FDF_ESI = 0x01, 0x02
_CLASSIC, _FD = struct.Struct("=IB3x8s"), struct.Struct("=IBBxx64s")
_CLASSIC_MTU, _FD_MTU = 16, 72
_FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)

# linux/can/error.h
_ERR_CONTROLLER, _ERR_BUS_OFF, _ERR_RESTARTED = 0x04, 0x40, 0x100
_CONTROLLER_STATES = (  # byte 1 of an ERR_CONTROLLER frame; the worst one wins
    (0x30, BusState.ERROR_PASSIVE),
    (0x0C, BusState.ERROR_WARNING),
    (0x40, BusState.ERROR_ACTIVE),
)

# linux/sockios.h, linux/if.h, linux/if_arp.h
_SIOCGIFFLAGS, _SIOCGIFMTU, _SIOCGIFHWADDR = 0x8913, 0x8921, 0x8927
_IFF_UP, _ARPHRD_CAN = 0x1, 280

# linux/net_tstamp.h: RX_HARDWARE | RAW_HARDWARE
_HARDWARE_STAMPS = (1 << 2) | (1 << 6)
_LATE_NS, _LATE_FOR_NS = 1_000_000, 250_000_000
"""An interrupt's latency is less, sooner or later."""


class HardwareClock:
    """A controller's free-running clock moved onto the epoch by its lowest latency.

    The kernel's stamp is the hardware's plus an interrupt latency that is never negative, so the
    smallest difference seen is the offset; it may grow by ``drift_ppm`` to follow the crystals.
    Where no frame of a quarter of a second comes within a millisecond of it, the kernel's clock was
    set forward, and the offset is found anew.
    """

    def __init__(self, drift_ppm: float = 200.0) -> None:
        self._drift = drift_ppm * 1e-6
        self._offset_ns: int | None = None
        self._last_ns = 0
        self._beyond: tuple[int, int] | None = None
        """Since when every frame was late, and the smallest difference since then."""

    def to_epoch_ns(self, hardware_ns: int, kernel_ns: int) -> int:
        """Epoch time (ns) of a frame by its hardware stamp (ns)."""
        seen = kernel_ns - hardware_ns
        if self._offset_ns is None:
            self._offset_ns = seen
        else:
            grown = round(max(0, hardware_ns - self._last_ns) * self._drift)
            self._offset_ns = self._as_set(min(self._offset_ns + grown, seen), hardware_ns, seen)
        self._last_ns = hardware_ns
        return hardware_ns + self._offset_ns

    def _as_set(self, offset_ns: int, hardware_ns: int, seen: int) -> int:
        if seen - offset_ns < _LATE_NS:
            self._beyond = None
            return offset_ns
        since_ns, least = self._beyond or (hardware_ns, seen)
        self._beyond = since_ns, min(least, seen)
        if abs(hardware_ns - since_ns) < _LATE_FOR_NS:
            return offset_ns
        found, self._beyond = self._beyond[1], None
        return found


class SocketCanPort(SocketPort):
    """One raw CAN socket on one interface; implements :class:`~eps_hil.bus.port.Port`."""

    def __init__(
        self,
        channel: str,
        *,
        fd: bool = False,
        receive_ids: Sequence[int] | None = None,
        send_ids: Sequence[int] | None = None,
        never_send_ids: Collection[int] = tuple(OWN),
        receive_buffer_bytes: int = RECEIVE_BUFFER_BYTES,
        receive_own: bool = False,
        hardware_stamps: bool = False,
    ) -> None:
        """Open and bind; :class:`BusError` naming the option and the remedy if anything is refused.

        ``hardware_stamps``: take the controller's stamp (moved onto the epoch) where a frame
        has one, else the kernel's. ``receive_own``: also deliver what this port sends.
        """
        rule = SendRule(f"socketcan:{channel}", send_ids, never_send_ids)
        self._fd = fd
        self._hardware = HardwareClock() if hardware_stamps else None
        sock = _raw_socket()
        try:
            _check_interface(sock, channel, fd)
            _configure(sock, channel, fd, receive_ids, receive_own, hardware_stamps)
            _give_buffer(sock, channel, receive_buffer_bytes)
            sock.bind((channel,))
        except OSError as error:
            sock.close()
            raise BusError(f"{channel}: cannot be opened: {error.strerror}") from None
        except BusError:
            sock.close()
            raise
        super().__init__(f"socketcan:{channel}", sock, rule)
        self._channel = channel
        link = can_link(channel)
        self._state = BusState.UNKNOWN if link is None else link.state

    def _parse(
        self, data: bytes, t_ns: int, hardware_ns: int, flags: int, address: Any
    ) -> Frame | None:
        fd = len(data) == _FD_MTU
        if fd:
            raw_id, length, fd_flags, payload = _FD.unpack(data)
        elif len(data) == _CLASSIC_MTU:
            raw_id, length, payload = _CLASSIC.unpack(data)
            fd_flags = 0
        else:
            return None  # CAN XL, which this socket does not ask for
        if hardware_ns and self._hardware is not None:
            t_ns = self._hardware.to_epoch_ns(hardware_ns, t_ns)
        error = bool(raw_id & _ERR_FLAG)
        if error:
            self._errors += 1
            self._note(raw_id & _ERR_MASK, payload)
        elif self._state is BusState.BUS_OFF:
            self._state = BusState.ERROR_ACTIVE  # nothing comes from a controller that is off
        extended = bool(raw_id & _EFF_FLAG)
        remote = bool(raw_id & _RTR_FLAG)
        return frame_of(
            t_ns,
            raw_id & (EXTENDED_ID_MAX if extended or error else STANDARD_ID_MAX),
            b"" if remote else payload[:length],
            extended,
            fd,
            error,
            bool(flags & socket.MSG_CONFIRM),
            remote,
            bool(fd_flags & _FDF_BRS),
            bool(fd_flags & _FDF_ESI),
            length if remote else 0,
        )

    def _note(self, classes: int, data: bytes) -> None:
        if classes & _ERR_BUS_OFF:
            self._state = BusState.BUS_OFF
        elif classes & _ERR_RESTARTED:
            self._state = BusState.ERROR_ACTIVE
        elif classes & _ERR_CONTROLLER:
            found = [state for bits, state in _CONTROLLER_STATES if data[1] & bits]
            self._state = found[0] if found else self._state

    def _when_silent(self) -> None:
        """The frame that tells of bus-off comes once and may be lost: ask, and restart it."""
        link = can_link(self._channel)
        if link is None or link.virtual:  # no controller: what error frames said stands
            return
        self._state = link.state
        if link.state is BusState.BUS_OFF and not link.restarts_itself:
            restart(self._channel)

    def _transmit(self, frame: Frame) -> None:
        self._sock.send(encode(frame, fd=self._fd))


def encode(frame: Frame, *, fd: bool) -> bytes:
    """The kernel's ``struct can_frame`` or ``struct canfd_frame``; :class:`BusError` if unfit."""
    limit = EXTENDED_ID_MAX if frame.extended or frame.error else STANDARD_ID_MAX
    if not 0 <= frame.can_id <= limit:
        raise BusError(f"id 0x{frame.can_id:X} does not fit; send it with extended=True")
    raw_id = frame.can_id | (_EFF_FLAG if frame.extended else 0)
    raw_id |= (_RTR_FLAG if frame.remote else 0) | (_ERR_FLAG if frame.error else 0)
    length = len(frame.data)
    if frame.fd:
        if not fd:
            raise BusError("a CAN FD frame on a port without FD; open it with fd: true")
        if length not in _FD_LENGTHS:
            raise BusError(f"{length} bytes is not a length of CAN FD; pad to the next of 8, 12..")
        return _FD.pack(raw_id, length, _FDF_BRS if frame.brs else 0, frame.data)
    if length > 8:
        raise BusError(f"{length} bytes do not fit into a classic frame; send it with fd=True")
    return _CLASSIC.pack(raw_id, frame.remote_length if frame.remote else length, frame.data)


def open_socketcan(
    channel: str,
    *,
    fd: bool,
    receive_ids: Sequence[int] | None,
    send_ids: Sequence[int] | None,
    never_send_ids: Collection[int] = tuple(OWN),
    options: Mapping[str, Any],
) -> Port:
    """:class:`SocketCanPort` with options from a configuration file."""
    known = ("hardware_stamps", "receive_buffer_bytes", "receive_own")
    note = " (the bit rate is set with ip link, not here)"
    with options_refused("socketcan", channel, options, known, note):
        return SocketCanPort(
            channel,
            fd=fd,
            receive_ids=receive_ids,
            send_ids=send_ids,
            never_send_ids=never_send_ids,
            **options,
        )


def _raw_socket() -> socket.socket:
    try:
        return socket.socket(_AF_CAN, socket.SOCK_RAW, _CAN_RAW)
    except OSError as error:
        remedy = {
            errno.EAFNOSUPPORT: "load it with modprobe can_raw, or use interface: udp_multicast",
            errno.EPROTONOSUPPORT: "load it with modprobe can_raw",
            errno.EPERM: "give the program CAP_NET_RAW",
        }.get(error.errno or 0, "use interface: udp_multicast")
        raise BusError(f"this kernel gives no SocketCAN ({error.strerror}); {remedy}") from None


def _check_interface(sock: socket.socket, channel: str, fd: bool) -> None:
    make = f"sudo ip link add dev {channel} type vcan"
    try:
        (hardware,) = struct.unpack_from("=H", _ask(sock, _SIOCGIFHWADDR, channel), 16)
    except OSError:
        known = [name for _, name in socket.if_nameindex() if "can" in name]
        have = f"there is {', '.join(known)}" if known else f"make one, e.g. {make}"
        raise AbsentBusError(f"{channel}: no such interface; {have}") from None
    if hardware != _ARPHRD_CAN:
        raise BusError(f"{channel}: is not a CAN interface; name one such as can0 or vcan0")
    (flags,) = struct.unpack_from("=H", _ask(sock, _SIOCGIFFLAGS, channel), 16)
    if not flags & _IFF_UP:
        raise AbsentBusError(f"{channel}: the interface is down; sudo ip link set {channel} up")
    (mtu,) = struct.unpack_from("=i", _ask(sock, _SIOCGIFMTU, channel), 16)
    if fd and mtu < _FD_MTU:
        raise BusError(
            f"{channel}: mtu {mtu} carries no CAN FD; sudo ip link set {channel} mtu {_FD_MTU} "
            "(a real controller: ip link set ... fd on)"
        )


def _ask(sock: socket.socket, request: int, channel: str) -> bytes:
    name = channel.encode()[:15]
    return fcntl.ioctl(sock.fileno(), request, struct.pack("16s24x", name))


def _configure(
    sock: socket.socket,
    channel: str,
    fd: bool,
    receive_ids: Sequence[int] | None,
    receive_own: bool,
    hardware_stamps: bool,
) -> None:
    def raw(option: int, value: Any, what: str) -> None:
        require_option(sock, _SOL_CAN_RAW, option, value, f"{what} on {channel}")

    stamp_and_count(sock, channel)
    if hardware_stamps:
        what = f"SO_TIMESTAMPING on {channel}; leave hardware_stamps out"
        require_option(sock, socket.SOL_SOCKET, SO_TIMESTAMPING, _HARDWARE_STAMPS, what)
    raw(_CAN_RAW_ERR_FILTER, struct.pack("=I", _ERR_MASK), "CAN_RAW_ERR_FILTER (error frames)")
    own = int(receive_own)
    raw(_CAN_RAW_RECV_OWN_MSGS, own, "CAN_RAW_RECV_OWN_MSGS")
    if fd:
        raw(_CAN_RAW_FD_FRAMES, 1, "CAN_RAW_FD_FRAMES; a kernel of 3.6 or later has CAN FD")
    if receive_ids is not None:
        raw(_CAN_RAW_FILTER, filters(receive_ids), "CAN_RAW_FILTER")


def filters(receive_ids: Sequence[int]) -> bytes:
    """``struct can_filter`` array that lets exactly these ids through (none: nothing).

    Up to 11 bits match in either format, since a list of numbers does not say which is meant.
    """
    if len(receive_ids) > _FILTERS_MAX:
        raise BusError(f"the kernel filters {_FILTERS_MAX} ids at most; map fewer messages")
    packed = b""
    for can_id in receive_ids:
        if not 0 <= can_id <= EXTENDED_ID_MAX:
            raise BusError(f"receive id 0x{can_id:X} is not a CAN id; 29 bits at most")
        standard = can_id <= STANDARD_ID_MAX
        mask = EXTENDED_ID_MAX if standard else EXTENDED_ID_MAX | _EFF_FLAG
        packed += struct.pack("=II", can_id | (0 if standard else _EFF_FLAG), mask)
    return packed


def _give_buffer(sock: socket.socket, channel: str, wanted: int) -> None:
    given = set_receive_buffer(sock, wanted)
    if given < wanted:
        raise BusError(
            f"{channel}: the kernel refused SO_RCVBUFFORCE and gave a receive buffer of {given} "
            f"of {wanted} bytes; sudo sysctl -w net.core.rmem_max={wanted}, or set option "
            f"receive_buffer_bytes: {given}"
        )
