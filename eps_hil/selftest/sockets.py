"""Sockets: the way of a frame between two processes, room for unread ones, stamps.

Over UDP on this machine, which takes the kernel's ways of SocketCAN (socket buffer, wake-up by
epoll, stamp with the datagram) without a bus. Nothing is sent on a bus that anybody listens to.
"""

import multiprocessing
import select
import socket
import struct
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection

from eps_hil.bus.socket_port import (
    RECEIVE_BUFFER_BYTES,
    SO_TIMESTAMPNS,
    set_receive_buffer,
    stamp_and_count,
)
from eps_hil.selftest.check import Check, Verdict, graded, graded_least

_FULL_BUS_FRAMES_S = 1e6 / 111
"""Frames of 8 bytes (111 bits without stuff bits) on a full bus of 1 Mbit/s."""
_FRAME = b"0123456789abcdef"  # as long as struct can_frame
_GOOD_P99_US, _LIMITED_P99_US = 500.0, 1000.0
_GOOD_ROOM_S, _LIMITED_ROOM_S = 0.25, 0.05
_TIMESPEC = struct.Struct("@qq")


@dataclass(frozen=True, slots=True)
class Loopback:
    """From the kernel's stamp of a datagram to its being read in another process, µs."""

    frames: int
    p50_us: float
    p99_us: float
    fifo: bool


def loopback(seconds: float, priority: int) -> Loopback:
    """One datagram each millisecond to a process that waits in epoll, as the service does."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    reader = context.Process(target=_read_until_silent, args=(theirs, priority), daemon=True)
    reader.start()
    try:
        if not ours.poll(60):
            raise OSError("the reading process did not start")
        address = ours.recv()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.connect(address)
            due = time.monotonic()
            for _ in range(max(100, round(seconds * 1000))):
                sender.send(_FRAME)
                due += 1e-3
                time.sleep(max(0.0, due - time.monotonic()))
            sender.send(b"")
        if not ours.poll(10):
            raise OSError("the reading process did not answer")
        late_us, fifo = ours.recv()
    finally:
        reader.join(5)
        if reader.is_alive():
            reader.kill()
    if not late_us:
        raise OSError("no datagram arrived")
    return Loopback(
        len(late_us), late_us[len(late_us) // 2], late_us[int(0.99 * len(late_us))], fifo
    )


def _read_until_silent(answer: Connection, priority: int) -> None:
    from eps_hil.service.realtime import hurry, quieten

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.setblocking(False)
        stamp_and_count(receiver, "loopback")
        poll = select.epoll()
        poll.register(receiver.fileno(), select.EPOLLIN)
        mode = "auto" if priority else "off"
        quieten(mode)  # type: ignore[arg-type]
        fifo = hurry(mode, priority).startswith("SCHED_FIFO")  # type: ignore[arg-type]
        answer.send(receiver.getsockname())
        late_us: list[float] = []
        while poll.poll(5.0):
            data, ancillary, _, _ = receiver.recvmsg(64, 256)
            now_ns = time.time_ns()
            if not data:
                break
            late_us += [(now_ns - _stamp_ns(p)) * 1e-3 for _, k, p in ancillary
                        if k == SO_TIMESTAMPNS]  # fmt: skip
        answer.send((sorted(late_us), fifo))


def _stamp_ns(payload: bytes) -> int:
    seconds, nanoseconds = _TIMESPEC.unpack_from(payload)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def judge_loopback(found: Loopback) -> Check:
    """Half a period, as for the wake-ups."""
    verdict = graded(found.p99_us, _GOOD_P99_US, _LIMITED_P99_US)
    how = "SCHED_FIFO" if found.fifo else "normal priority"
    return Check(
        "loopback", "frame to another process (UDP)",
        f"p50 {found.p50_us:.0f} us, p99 {found.p99_us:.0f} us ({how}, {found.frames} frames)",
        f"p99 {_GOOD_P99_US:.0f} us", verdict, "half a period is for the step and for sending",
        "" if verdict == Verdict.GOOD else "as for the wake-ups", found.p99_us, "us",
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Room:
    """``given_bytes`` of the receive buffer asked for; ``frames`` that really stayed in it."""

    given_bytes: int
    frames: int


def receive_room(wanted_bytes: int = RECEIVE_BUFFER_BYTES) -> Room:
    """Ask as the bus ports do, then send until the kernel drops."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        given = set_receive_buffer(receiver, wanted_bytes)
        receiver.bind(("127.0.0.1", 0))
        receiver.setblocking(False)
        sender.connect(receiver.getsockname())
        sent = 4 + given // 128  # the kernel counts several times the payload of small datagrams
        for _ in range(sent):
            sender.send(_FRAME)
        kept = 0
        try:
            while True:
                receiver.recv(64)
                kept += 1
        except BlockingIOError:
            return Room(given, kept)


def judge_room(found: Room, socketcan: bool) -> Check:
    """Long enough for a pause of the process; SocketCAN refuses to start with less than asked."""
    holds_s = found.frames / _FULL_BUS_FRAMES_S
    verdict = graded_least(holds_s, _GOOD_ROOM_S, _LIMITED_ROOM_S)
    refused = found.given_bytes < RECEIVE_BUFFER_BYTES
    if refused and socketcan:
        verdict = Verdict.NOT_GOOD
    return Check(
        "receive_buffer", "receive buffer",
        f"{found.given_bytes} of {RECEIVE_BUFFER_BYTES} bytes: {found.frames} frames, "
        f"{holds_s:.2f} s of a full 1 Mbit/s bus", f"{_GOOD_ROOM_S:g} s", verdict,
        "a process that stands still for longer than that loses frames",
        f"sudo sysctl -w net.core.rmem_max={RECEIVE_BUFFER_BYTES} (or CAP_NET_ADMIN)"
        if refused or verdict != Verdict.GOOD else "", holds_s, "s",
    )  # fmt: skip


def software_stamps() -> Check:
    """The kernel's receive stamps and its count of dropped frames, as every port needs them."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        stamp_and_count(sock, "loopback")
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(1.0)
        sock.sendto(_FRAME, sock.getsockname())
        _, ancillary, _, _ = sock.recvmsg(64, 256)
    there = any(kind == SO_TIMESTAMPNS for _, kind, _ in ancillary)
    return Check(
        "software_stamps", "receive stamps of the kernel", "ns" if there else "none", "ns",
        Verdict.GOOD if there else Verdict.NOT_GOOD,
        "the estimator steps in sample time; a program's own stamp is late by its wake-up",
        "" if there else "a Linux kernel (SO_TIMESTAMPNS); some containers' kernels lack it",
    )  # fmt: skip
