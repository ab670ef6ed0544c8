"""Whatever bus python-can opens is a port like any other."""

import asyncio
import itertools
import os
import socket
import threading
import time
import uuid
from collections.abc import Callable

import can
import pytest

from eps_hil.bus import python_can
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Port, PortCounts, open_port
from eps_hil.bus.python_can import PythonCanPort
from eps_hil.errors import BusError

Collect = Callable[[Port, int], list[Frame]]


@pytest.fixture
def channel() -> str:
    return uuid.uuid4().hex


class PipeBus(can.BusABC):  # type: ignore[misc,unused-ignore]
    """A driver with a file descriptor and frames waiting behind it, as socketcand has."""

    def __init__(self, channel: str, stamp_s: float = 0.0) -> None:
        self._read_end, self.write_end = os.pipe()
        os.set_blocking(self._read_end, False)
        self._waiting: list[can.Message] = []
        self.stamp_s = stamp_s
        self.fail_with: Exception | None = None
        super().__init__(channel)

    def put(self, count: int) -> None:
        os.write(self.write_end, b"x")
        for k in range(count):
            stamp_s = self.stamp_s + k * 1e-3 if self.stamp_s else 0.0
            self._waiting.append(can.Message(arbitration_id=k, data=[k], timestamp=stamp_s))

    def fileno(self) -> int:
        return self._read_end

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.fail_with is not None:
            raise self.fail_with
        try:
            os.read(self._read_end, 100)
        except BlockingIOError:
            time.sleep(0 if self._waiting else min(timeout or 0.0, 0.01))
        return (self._waiting.pop(0) if self._waiting else None), False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("transmit queue full")

    def shutdown(self) -> None:
        super().shutdown()
        os.close(self._read_end)
        os.close(self.write_end)


@pytest.fixture
def pipe(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[PythonCanPort, PipeBus]]:
    def made(stamp_s: float = 0.0) -> tuple[PythonCanPort, PipeBus]:
        bus = PipeBus("pipe", stamp_s)
        monkeypatch.setattr(can, "Bus", lambda **_: bus)
        return PythonCanPort("virtual", "pipe"), bus

    return made


def test_virtual_ports_see_each_other_and_not_themselves(channel: str, collect: Collect) -> None:
    ours, other = open_port("virtual", channel), open_port("virtual", channel)
    before_ns = time.time_ns()
    for k in range(50):
        assert ours.send(Frame(0, 0x100 + k, bytes([k])))
    got = collect(other, 50)
    assert [(f.can_id, f.data) for f in got] == [(0x100 + k, bytes([k])) for k in range(50)]
    assert all(before_ns - 1_000 <= f.t_ns <= time.time_ns() + 1_000 for f in got)
    assert ours.recv(0.0) == []
    assert ours.counts == PortCounts(sent=50)
    assert other.counts == PortCounts(received=50)
    ours.close()
    other.close()


def test_a_reader_thread_hands_batches_to_the_loop_in_order(channel: str) -> None:
    """``virtual`` has no file descriptor, so this is the thread's path."""
    batches: list[list[Frame]] = []

    async def run() -> None:
        ours, other = open_port("virtual", channel), open_port("virtual", channel)
        ours.start(asyncio.get_running_loop(), batches.append)
        for k in range(500):
            other.send(Frame(0, 0x100 + k, b""))
        for _ in range(200):
            await asyncio.sleep(0.01)
            if sum(map(len, batches)) == 500:
                break
        ours.close()
        other.send(Frame(0, 0x7FF, b""))
        await asyncio.sleep(0.05)
        other.close()

    asyncio.run(run())
    assert [f.can_id for batch in batches for f in batch] == list(range(0x100, 0x100 + 500))


def test_one_wake_up_of_a_descriptor_drains_all_that_waits(
    pipe: Callable[..., tuple[PythonCanPort, PipeBus]],
) -> None:
    port, bus = pipe()
    batches: list[list[Frame]] = []

    async def run() -> None:
        port.start(asyncio.get_running_loop(), batches.append)
        bus.put(100)
        await asyncio.sleep(0.05)
        port.close()

    asyncio.run(run())
    assert [[f.can_id for f in batch] for batch in batches] == [list(range(100))]


def test_a_bus_that_breaks_is_told_once(
    pipe: Callable[..., tuple[PythonCanPort, PipeBus]],
) -> None:
    port, bus = pipe()
    told: list[str] = []

    async def run() -> None:
        port.start(asyncio.get_running_loop(), lambda _: None, told.append)
        bus.fail_with = can.CanOperationError("the adapter\nwas pulled")
        bus.put(1)
        await asyncio.sleep(0.05)

    asyncio.run(run())
    assert told == ["the adapter was pulled"]
    assert port.state is BusState.LOST
    with pytest.raises(BusError, match="the adapter was pulled"):
        port.recv(0.0)
    with pytest.raises(BusError, match="the adapter was pulled"):
        port.send(Frame(0, 1, b""))
    port.close()


def test_a_full_transmit_queue_drops_and_counts(
    pipe: Callable[..., tuple[PythonCanPort, PipeBus]],
) -> None:
    port, _ = pipe()
    assert not port.send(Frame(0, 1, b""))
    assert port.counts == PortCounts(send_dropped=1)
    port.close()


def test_the_port_follows_a_crystal_that_drifts(
    pipe: Callable[..., tuple[PythonCanPort, PipeBus]], monkeypatch: pytest.MonkeyPatch
) -> None:
    port, _ = pipe(12.5)
    port.recv(0.0)
    start_ns = time.time_ns()
    for k in range(1, 60_000):
        now_ns = start_ns + k * 1_000_000
        monkeypatch.setattr(python_can, "_clocks", lambda now_ns=now_ns: (now_ns, now_ns - 10**18))
        told_ns = port._epoch_ns(12.5 + k * 1e-3 * (1.0 - 100e-6))
    assert abs(told_ns - now_ns) < 500_000, "6 ms by one offset taken at the start"


@pytest.mark.parametrize("stamp_s", [12.5, 0.0])
def test_stamps_of_a_clock_since_boot_are_moved_onto_the_epoch(
    pipe: Callable[..., tuple[PythonCanPort, PipeBus]], stamp_s: float
) -> None:
    port, bus = pipe(stamp_s)
    bus.put(3)
    stamps = [f.t_ns for f in port.recv(1.0)]
    assert abs(stamps[0] - time.time_ns()) < 1_000_000_000
    if stamp_s:
        assert [b - a for a, b in itertools.pairwise(stamps)] == [1_000_000, 1_000_000]
    port.close()


def test_a_socketcand_server_is_a_bus(collect: Collect) -> None:
    """The protocol of linux-can/socketcand, as far as its README describes raw mode."""
    heard: list[str] = []
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        link, _ = server.accept()
        with link:
            link.sendall(b"< hi >")
            for answer in (b"< ok >", b"< ok >"):
                heard.append(link.recv(200).decode())
                link.sendall(answer)
            link.sendall(b"< frame 123 1757617431.821276 1122 >< frame 18FF0001 1757617431.9 03 >")
            heard.append(link.recv(200).decode())

    thread = threading.Thread(target=serve)
    thread.start()
    options = {"host": "127.0.0.1", "port": server.getsockname()[1]}
    port = open_port("socketcand", "can0", options=options)
    batches: list[list[Frame]] = []

    async def run() -> None:
        port.start(asyncio.get_running_loop(), batches.append)
        for _ in range(100):
            await asyncio.sleep(0.02)
            if sum(map(len, batches)) == 2:
                break
        assert port.send(Frame(0, 0x321, b"\xab"))
        await asyncio.sleep(0.05)
        port.close()

    asyncio.run(run())
    thread.join(5.0)
    server.close()
    got = [frame for batch in batches for frame in batch]
    assert [(f.can_id, f.data, f.extended) for f in got] == [
        (0x123, b"\x11\x22", False),
        (0x18FF0001, b"\x03", True),
    ]
    assert heard[:2] == ["< open can0 >", "< rawmode >"]
    assert heard[2].split()[:4] == ["<", "send", "321", "1"]


def test_ids_are_filtered_and_error_frames_counted(channel: str, collect: Collect) -> None:
    ours = open_port("virtual", channel, receive_ids=[0x10, 0x12345], send_ids=[])
    other = open_port("virtual", channel)
    for can_id, extended in ((0x10, False), (0x11, False), (0x12345, True)):
        other.send(Frame(0, can_id, b"", extended=extended))
    assert [f.can_id for f in collect(ours, 2)] == [0x10, 0x12345]
    with pytest.raises(BusError, match="not configured to send id 0x1"):
        ours.send(Frame(0, 1, b""))
    ours.close()
    ours.close()
    other.close()


@pytest.mark.parametrize(
    ("interface", "options", "said"),
    [
        ("virtul", {}, "did you mean virtual"),
        ("no such thing", {}, "python-can's list"),
        ("vector", {}, "driver"),
        ("socketcand", {}, "an option does not fit .*host"),
        ("slcan", {}, "slcan:can0 cannot be opened|driver"),
    ],
)
def test_a_bus_that_cannot_be_opened_says_so_in_one_line(
    interface: str, options: dict[str, object], said: str
) -> None:
    with pytest.raises(BusError, match=said) as caught:
        open_port(interface, "can0", options=options)
    assert "\n" not in str(caught.value)
