"""A CAN port on a datagram socket: drained in batches, stamped and counted by the kernel.

Common ground of :mod:`eps_hil.bus.socketcan` and :mod:`eps_hil.bus.udp_multicast`. Own code,
because the numbers a rig lives by are not to be had from python-can: integer nanosecond stamps,
the exact count of frames that the kernel dropped, and a receive buffer that was read back.
"""

import asyncio
import contextlib
import errno
import os
import select
import socket
import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from eps_hil.bus.eager_loop import EagerLoop
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Deliver, OnLost, PortCounts, SendRule
from eps_hil.errors import BusError

RECEIVE_BUFFER_BYTES = 4 << 20  # 2,000 unread frames overran the kernel's 208 KiB default

# asm-generic/socket.h; Python's socket module does not name them
SO_RCVBUFFORCE = 33
SO_TIMESTAMPNS = 35
SO_TIMESTAMPING = 37
SO_RXQ_OVFL = 40
SO_MEMINFO = 55
_MEMINFO_DROPS = 8  # index of SK_MEMINFO_DROPS in the array of u32, linux/sock_diag.h

_TIMESPEC = struct.Struct("@qq")
_TIMESTAMPING = struct.Struct("@6q")
_MEMINFO = struct.Struct("@9I")
_U32 = struct.Struct("@I")
_MOST_BYTES = 960
"""Of one datagram: some four times what a frame of CAN FD takes."""
_ANCILLARY_BYTES = socket.CMSG_SPACE(16) + socket.CMSG_SPACE(48) + socket.CMSG_SPACE(4)

_FRESH_NS = 300_000  # nothing that matters has queued up behind a frame of this age
_LOOK_NS = 1_000_000_000
"""How often a silent bus is looked after."""

# So many frames per wake-up at most: other callbacks of the loop get their turn, and the
# level-triggered selector calls again at once.
_BATCH_MAX = 1024
_FULL = {errno.ENOBUFS, errno.EAGAIN, errno.EWOULDBLOCK, errno.ENOMEM}


@contextlib.contextmanager
def options_refused(
    interface: str, channel: str, options: Mapping[str, Any], known: Sequence[str], note: str = ""
) -> Iterator[None]:
    """:class:`BusError` for an option that is not ``known``, or whose value the block refuses."""
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise BusError(f"{interface} has no option '{unknown[0]}'; known: {', '.join(known)}{note}")
    try:
        yield
    except (TypeError, ValueError, OverflowError, struct.error) as error:
        raise BusError(f"{channel}: an option has a value that does not fit: {error}") from None


class SocketPort(ABC):
    """The part of a :class:`~eps_hil.bus.port.Port` that any datagram socket shares."""

    def __init__(self, name: str, sock: socket.socket, rule: SendRule) -> None:
        sock.setblocking(False)
        self.name = name
        self._sock = sock
        self._rule = rule
        self._poll = select.poll()
        self._poll.register(sock.fileno(), select.POLLIN)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._deliver: Deliver | None = None
        self._on_lost: OnLost | None = None
        self._state = BusState.UNKNOWN
        self._lost_reason = ""
        self._closed = False
        self._timer: asyncio.TimerHandle | None = None
        self._looked_ns, self._looked_at = time.monotonic_ns(), 0
        self.urgent_id: int | None = None
        """Frames of this id are handed over at once when they are fresh, without a look whether
        more wait: that look costs as much as reading a frame."""
        self._received = self._sent = self._dropped = self._errors = self._kernel_drops = 0

    @abstractmethod
    def _parse(
        self, data: bytes, t_ns: int, hardware_ns: int, flags: int, address: Any
    ) -> Frame | None:
        """One datagram -> frame; None for what is not for us."""

    @abstractmethod
    def _transmit(self, frame: Frame) -> None:
        """Write one frame to the socket; OSError as the kernel says it."""

    @abstractmethod
    def _when_silent(self) -> None:
        """Once a second while nothing comes; OSError where the bus is gone."""

    @property
    def counts(self) -> PortCounts:
        """A snapshot; the kernel is asked for its drops, so loss at the very end shows too."""
        if not self._closed:
            self._kernel_drops = self._drops_so_far()
        return PortCounts(
            self._received, self._sent, self._dropped, self._kernel_drops, self._errors
        )

    @property
    def state(self) -> BusState:
        """State by the last error frame; ``LOST`` once the interface is gone."""
        return self._state

    def fileno(self) -> int:
        """File descriptor that is readable when frames are pending."""
        return self._sock.fileno()

    def widen(self, size_bytes: int) -> int:
        """Have the kernel keep so much for us at least, where it may; what it keeps now, bytes."""
        now = self._sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
        if size_bytes > now:
            with contextlib.suppress(OSError):  # SO_RCVBUF would give less than there is
                self._sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, size_bytes)
        return self._sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2

    def start(
        self, loop: asyncio.AbstractEventLoop, deliver: Deliver, on_lost: OnLost | None = None
    ) -> None:
        """See :meth:`eps_hil.bus.port.Port.start`."""
        self._loop, self._deliver, self._on_lost = loop, deliver, on_lost
        if isinstance(loop, EagerLoop):
            loop.add_eager_reader(self._sock.fileno(), self._on_readable)
        else:
            loop.add_reader(self._sock.fileno(), self._on_readable)
        self._timer = loop.call_later(_LOOK_NS * 1e-9, self._look_again)

    def send(self, frame: Frame) -> bool:
        """See :meth:`eps_hil.bus.port.Port.send`."""
        self._rule.check(frame)
        if self._closed or self._lost_reason:
            raise BusError(f"{self.name}: {self._lost_reason or 'the port is closed'}")
        try:
            self._transmit(frame)
        except OSError as error:
            if error.errno in _FULL:
                self._dropped += 1
                return False
            self._lose(error)
            self._tell_lost()
            raise BusError(f"{self.name}: {self._lost_reason}") from None
        self._sent += 1
        return True

    def recv(self, timeout_s: float) -> list[Frame]:
        """See :meth:`eps_hil.bus.port.Port.recv`."""
        if self._closed:
            raise BusError(f"{self.name}: the port is closed")
        deadline = time.monotonic() + timeout_s
        frames = self._drain()
        while not frames:
            if self._lost_reason:
                raise BusError(f"{self.name}: {self._lost_reason}")
            left_s = deadline - time.monotonic()
            if left_s <= 0.0:
                self._look_after()
                break
            # poll counts whole milliseconds, and a rounded-down wait would spin
            self._poll.poll(max(1, round(left_s * 1e3)))
            frames = self._drain()
        return frames

    def close(self) -> None:
        """Stop delivering and close the socket."""
        if self._closed:
            return
        self._kernel_drops = self._drops_so_far()
        self._closed = True
        self._stop_reading()
        self._sock.close()

    def _on_readable(self) -> None:
        frames = self._drain()
        if frames and self._deliver is not None:
            self._deliver(frames)
        if self._lost_reason:
            self._tell_lost()

    def _look_again(self) -> None:
        """The loop's timer."""
        if self._loop is None:
            return
        self._timer = self._loop.call_later(_LOOK_NS * 1e-9, self._look_again)
        self._look_after()
        if self._lost_reason:
            self._tell_lost()

    def _look_after(self) -> None:
        """Where nothing came for a second, see whether anything still can."""
        now_ns = time.monotonic_ns()
        if now_ns - self._looked_ns < _LOOK_NS // 2:
            return
        silent, self._looked_at = self._received == self._looked_at, self._received
        self._looked_ns = now_ns
        if not silent or self._lost_reason:
            return
        try:
            self._when_silent()
        except OSError as error:
            self._lose(error)

    def _drain(self) -> list[Frame]:
        frames: list[Frame] = []
        receive, parse, unpack = self._sock.recvmsg, self._parse, _TIMESPEC.unpack
        for _ in range(_BATCH_MAX):
            try:
                data, ancillary, flags, address = receive(_MOST_BYTES, _ANCILLARY_BYTES)
            except BlockingIOError:
                break
            except OSError as error:
                if self._closed or self._lost_reason:
                    break
                self._lose(error)  # said once, ahead of the frames that wait in the queue
                continue
            if len(ancillary) == 1 and ancillary[0][1] == SO_TIMESTAMPNS:  # as almost always
                seconds, nanoseconds = unpack(ancillary[0][2])
                t_ns, hardware_ns = seconds * 1_000_000_000 + nanoseconds, 0
            else:
                t_ns, hardware_ns = self._stamps(ancillary)
            frame = parse(data, t_ns, hardware_ns, flags, address)
            if frame is not None:
                frames.append(frame)
                if frame.can_id == self.urgent_id and 0 <= time.time_ns() - t_ns < _FRESH_NS:
                    break
        self._received += len(frames)
        return frames

    def _stamps(self, ancillary: list[tuple[int, int, bytes]]) -> tuple[int, int]:
        """(kernel's stamp, hardware's stamp or 0), ns; the drop counter is read on the way."""
        t_ns = hardware_ns = 0
        for _level, kind, payload in ancillary:
            if kind == SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIMESPEC.unpack_from(payload)
                t_ns = seconds * 1_000_000_000 + nanoseconds
            elif kind == SO_RXQ_OVFL:
                (self._kernel_drops,) = _U32.unpack_from(payload)
            elif kind == SO_TIMESTAMPING:
                stamps = _TIMESTAMPING.unpack_from(payload)
                hardware_ns = stamps[4] * 1_000_000_000 + stamps[5]
        return t_ns or time.time_ns(), hardware_ns

    def _drops_so_far(self) -> int:
        try:
            memory = self._sock.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, _MEMINFO.size)
        except OSError:  # a kernel before 4.12: what the last frame told
            return self._kernel_drops
        return int(_MEMINFO.unpack(memory)[_MEMINFO_DROPS])

    def _lose(self, error: OSError) -> None:
        words = {
            errno.ENETDOWN: "the interface went down",
            errno.ENODEV: "the interface was removed",
            errno.ENXIO: "the interface was removed",
        }
        said = os.strerror(error.errno) if error.errno else str(error)
        self._lost_reason = words.get(error.errno or 0, said)
        self._state = BusState.LOST

    def _tell_lost(self) -> None:
        self._stop_reading()
        told, self._on_lost = self._on_lost, None
        if told is not None:
            told(self._lost_reason)

    def _stop_reading(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._loop is not None and not self._loop.is_closed():
            if isinstance(self._loop, EagerLoop):
                self._loop.remove_eager_reader(self._sock.fileno())
            else:
                self._loop.remove_reader(self._sock.fileno())
        self._loop = self._deliver = None


def require_option(sock: socket.socket, level: int, option: int, value: Any, what: str) -> None:
    """Set a socket option; :class:`BusError` with name and remedy in ``what`` if refused."""
    try:
        sock.setsockopt(level, option, value)
    except OSError as error:
        raise BusError(f"the kernel refused {what} ({error.strerror})") from None


def set_receive_buffer(sock: socket.socket, size_bytes: int) -> int:
    """Ask for ``size_bytes`` (by force where allowed); returns what the kernel really gave.

    The kernel doubles what it is asked for, to make room for its own bookkeeping; the figure
    returned is comparable with ``size_bytes``.
    """
    try:
        sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, size_bytes)
    except OSError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size_bytes)
    return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


def stamp_and_count(sock: socket.socket, name: str) -> None:
    """Kernel receive stamps in ns and the drop counter, with every datagram."""
    require_option(
        sock,
        socket.SOL_SOCKET,
        SO_TIMESTAMPNS,
        1,
        f"SO_TIMESTAMPNS on {name}; a Linux kernel of 2.6.22 or later gives receive stamps",
    )
    require_option(
        sock,
        socket.SOL_SOCKET,
        SO_RXQ_OVFL,
        1,
        f"SO_RXQ_OVFL on {name}; a Linux kernel of 2.6.33 or later counts lost frames",
    )
