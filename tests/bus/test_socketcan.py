"""Our own SocketCAN socket, on a real vcan0 (User-Mode Linux where the machine has none)."""

import asyncio
import os
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from eps_hil.bus import replay
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Port, open_port
from eps_hil.bus.record_parts import Target
from eps_hil.bus.recorder import Channel, Recorder
from eps_hil.bus.socketcan import SocketCanPort
from eps_hil.errors import AbsentBusError, BusError

Collect = Callable[[Port, int], list[Frame]]
pytestmark = pytest.mark.socketcan


def test_frames_arrive_in_order_with_kernel_stamps_of_now(vcan: str, collect: Collect) -> None:
    receiver, sender = SocketCanPort(vcan), SocketCanPort(vcan)
    before_ns = time.time_ns()
    for k in range(100):
        assert sender.send(Frame(0, 0x100 + k, bytes([k])))
    after_ns = time.time_ns()
    frames = collect(receiver, 100)
    assert [(f.can_id, f.data) for f in frames] == [(0x100 + k, bytes([k])) for k in range(100)]
    stamps = [f.t_ns for f in frames]
    assert stamps == sorted(stamps)
    # 10 ms: the coarse clock of a guest kernel may lag behind the one that time_ns reads
    assert before_ns - 10_000_000 <= stamps[0]
    assert stamps[-1] <= after_ns + 10_000_000
    assert sender.recv(0.0) == []  # its own frames are not its business
    assert receiver.counts.received == 100
    assert sender.counts.sent == 100
    receiver.close()
    sender.close()


def test_own_frames_are_marked_when_asked_for(vcan: str, collect: Collect) -> None:
    port = SocketCanPort(vcan, receive_own=True)
    port.send(Frame(0, 0x42, b"me"))
    subprocess.run(["cansend", vcan, "043#00"], check=True)
    assert [(f.can_id, f.own) for f in collect(port, 2)] == [(0x42, True), (0x43, False)]
    port.close()


def test_the_loss_of_an_overrun_is_counted_to_the_frame(vcan: str, collect: Collect) -> None:
    receiver = SocketCanPort(vcan, receive_buffer_bytes=100_000)
    sender = SocketCanPort(vcan)
    for k in range(2_000):
        assert sender.send(Frame(0, 0x10, struct.pack("<I", k)))
    got = len(receiver.recv(0.1))
    while more := receiver.recv(0.1):
        got += len(more)
    assert 0 < got < 2_000
    assert receiver.counts.lost_in_kernel == 2_000 - got
    sender.send(Frame(0, 0x11, b""))
    assert len(collect(receiver, 1)) == 1  # it goes on, and the count stays
    assert receiver.counts.lost_in_kernel == 2_000 - got
    receiver.close()
    sender.close()


def test_the_default_buffer_loses_none_of_2000_unread_frames(vcan: str, collect: Collect) -> None:
    receiver, sender = SocketCanPort(vcan), SocketCanPort(vcan)
    for _ in range(2_000):
        sender.send(Frame(0, 0x10, bytes(8)))
    assert len(collect(receiver, 2_000)) == 2_000
    assert receiver.counts.lost_in_kernel == 0
    receiver.close()
    sender.close()


@pytest.mark.parametrize(
    ("can_id", "data", "state"),
    [
        (0x004, bytes([0, 0x08, 0, 0, 0, 0, 96, 0]), BusState.ERROR_WARNING),
        (0x004, bytes([0, 0x20, 0, 0, 0, 0, 128, 0]), BusState.ERROR_PASSIVE),
        (0x004, bytes([0, 0x40, 0, 0, 0, 0, 0, 0]), BusState.ERROR_ACTIVE),
        (0x040, bytes(8), BusState.BUS_OFF),
        (0x100, bytes(8), BusState.ERROR_ACTIVE),
    ],
)
def test_error_frames_are_delivered_and_tell_the_state(
    vcan: str, collect: Collect, can_id: int, data: bytes, state: BusState
) -> None:
    receiver, sender = SocketCanPort(vcan, receive_ids=[0x7FF]), SocketCanPort(vcan)
    sender.send(Frame(0, can_id, data, error=True))
    (frame,) = collect(receiver, 1)
    assert (frame.error, frame.can_id, frame.data) == (True, can_id, data)
    assert receiver.state is state
    assert receiver.counts.error_frames == 1
    receiver.close()
    sender.close()


def test_fd_frames_pass_on_fd_ports_and_are_not_seen_on_others(vcan: str, collect: Collect) -> None:
    wide, sender, narrow = SocketCanPort(vcan, fd=True), SocketCanPort(vcan, fd=True), None
    narrow = SocketCanPort(vcan)
    sent = [Frame(0, 0x1ABCDEF, bytes(range(64)), extended=True, fd=True, brs=True)]
    sent += [Frame(0, 0x123, b"classic")]
    for frame in sent:
        sender.send(frame)
    got = collect(wide, 2)
    assert [(f.can_id, f.data, f.extended, f.fd, f.brs) for f in got] == [
        (f.can_id, f.data, f.extended, f.fd, f.brs) for f in sent
    ]
    assert [f.data for f in collect(narrow, 1)] == [b"classic"]
    with pytest.raises(BusError, match="fd: true"):
        narrow.send(sent[0])
    for port in (wide, sender, narrow):
        port.close()


def test_the_kernel_filters_by_id(vcan: str, collect: Collect) -> None:
    receiver = SocketCanPort(vcan, receive_ids=[0x100, 0x18FF0001])
    nothing = SocketCanPort(vcan, receive_ids=[])
    for word in ("100#01", "101#02", "18FF0001#03", "18FF0002#04", "100#R"):
        subprocess.run(["cansend", vcan, word], check=True)
    assert [(f.can_id, f.remote) for f in collect(receiver, 3)] == [
        (0x100, False),
        (0x18FF0001, False),
        (0x100, True),
    ]
    assert nothing.recv(0.05) == []
    receiver.close()
    nothing.close()


def test_only_configured_ids_are_sent(vcan: str) -> None:
    port = SocketCanPort(vcan, send_ids=[0x200])
    assert port.send(Frame(0, 0x200, b""))
    with pytest.raises(BusError, match="not configured to send id 0x201"):
        port.send(Frame(0, 0x201, b""))
    port.close()


def test_the_loop_gets_whole_batches(vcan: str) -> None:
    batches: list[list[Frame]] = []

    async def run() -> None:
        receiver, sender = SocketCanPort(vcan), SocketCanPort(vcan)
        receiver.start(asyncio.get_running_loop(), batches.append)
        for k in range(300):
            sender.send(Frame(0, 0x10, struct.pack("<I", k)))
        for _ in range(100):
            await asyncio.sleep(0.02)
            if sum(map(len, batches)) == 300:
                break
        receiver.close()
        sender.close()

    asyncio.run(run())
    sent = [struct.unpack("<I", f.data)[0] for batch in batches for f in batch]
    assert sent == list(range(300))
    assert len(batches) < 300


@pytest.mark.parametrize("how", ["down", "removed"])
def test_an_interface_that_goes_away_is_told_once(brief_vcan: str, how: str) -> None:
    told: list[str] = []
    batches: list[list[Frame]] = []

    async def run() -> None:
        port = SocketCanPort(brief_vcan)
        port.start(asyncio.get_running_loop(), batches.append, told.append)
        words = ["set", brief_vcan, "down"] if how == "down" else ["del", brief_vcan]
        subprocess.run(["cansend", brief_vcan, "123#AA"], check=True)
        subprocess.run(["ip", "link", *words], check=True)
        for _ in range(100):
            await asyncio.sleep(0.02)
            if told:
                break
        assert port.state is BusState.LOST
        with pytest.raises(BusError, match="the interface"):
            port.send(Frame(0, 1, b""))
        port.close()

    asyncio.run(run())
    assert len(told) == 1
    assert "the interface" in told[0]
    assert [f.can_id for batch in batches for f in batch] == [0x123]  # before the end, not lost


def test_a_synchronous_user_hears_of_it_too(brief_vcan: str) -> None:
    port = SocketCanPort(brief_vcan)
    subprocess.run(["ip", "link", "del", brief_vcan], check=True)
    with pytest.raises(BusError, match="the interface"):
        port.recv(1.0)
    port.close()


def test_what_cannot_be_opened_names_the_remedy(vcan: str, brief_vcan: str) -> None:
    subprocess.run(["ip", "link", "set", brief_vcan, "down"], check=True)
    with pytest.raises(AbsentBusError, match="ip link set vcan7 up"):
        open_port("socketcan", brief_vcan)
    subprocess.run(["ip", "link", "set", brief_vcan, "mtu", "16"], check=True)
    subprocess.run(["ip", "link", "set", brief_vcan, "up"], check=True)
    with pytest.raises(BusError, match="mtu 72"):
        open_port("socketcan", brief_vcan, fd=True)
    with pytest.raises(AbsentBusError, match="no such interface; there is vcan"):
        open_port("socketcan", "can9")
    with pytest.raises(BusError, match="not a CAN interface"):
        open_port("socketcan", "lo")
    with pytest.raises(BusError, match="no option 'bitrate'"):
        open_port("socketcan", vcan, options={"bitrate": 500_000})
    with pytest.raises(BusError, match="does not fit"):
        open_port("socketcan", vcan, options={"receive_buffer_bytes": "much"})


def test_without_the_right_to_force_the_buffer_the_start_is_refused(vcan: str) -> None:
    as_nobody = (
        "import os\n"
        "import eps_hil.bus.socketcan\n"
        "from eps_hil.bus.port import open_port\n"
        "from eps_hil.errors import BusError\n"
        "os.setuid(65534)\n"
        "try: open_port('socketcan', 'vcan0', options={'receive_buffer_bytes': 1 << 28})\n"
        "except BusError as error: print(error)\n"
        "port = open_port('socketcan', 'vcan0', options={'receive_buffer_bytes': 50_000})\n"
        "print(len(port.recv(0.0)))\n"
    )
    if os.geteuid() != 0:
        pytest.skip("drops root's rights, so it needs them; run the tests as root")
    words = [sys.executable, "-c", as_nobody]
    run = subprocess.run(words, check=False, capture_output=True, text=True)
    assert "SO_RCVBUFFORCE" in run.stdout, run.stderr
    assert "sysctl -w net.core.rmem_max=268435456" in run.stdout
    assert run.stdout.splitlines()[-1] == "0"


def test_can_utils_see_what_we_send_and_we_what_they_send(vcan: str, collect: Collect) -> None:
    port = SocketCanPort(vcan, fd=True)
    ready = Path("/proc/net/can/rcvlist_all").read_text().count(vcan) + 1
    dump = subprocess.Popen(
        ["candump", "-L", "-n", "3", vcan], stdout=subprocess.PIPE, text=True, bufsize=1
    )
    while Path("/proc/net/can/rcvlist_all").read_text().count(vcan) < ready:
        time.sleep(0.01)
    port.send(Frame(0, 0x123, bytes.fromhex("DEADBEEF")))
    port.send(Frame(0, 0x18FEF100, b"\x01", extended=True))
    port.send(Frame(0, 0x321, bytes(12), fd=True, brs=True))
    out, _ = dump.communicate(timeout=20)
    first, second, third = (line.split()[2] for line in out.splitlines())
    assert (first, second) == ("123#DEADBEEF", "18FEF100#01")
    # bit 0 of the nibble is BRS; newer kernels set bit 2 (FDF) as well
    assert third in {"321##1" + "00" * 12, "321##5" + "00" * 12}
    subprocess.run(["cansend", vcan, "456##1" + "AB" * 16], check=True)
    (frame,) = collect(port, 1)
    assert (frame.can_id, frame.data, frame.fd, frame.brs) == (0x456, b"\xab" * 16, True, True)
    port.close()


def test_python_can_is_a_peer_both_ways(vcan: str, collect: Collect) -> None:
    import can

    port = SocketCanPort(vcan)
    with can.Bus(interface="socketcan", channel=vcan) as bus:
        port.send(Frame(0, 0x77, b"to them"))
        message = bus.recv(2.0)
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (0x77, b"to them")
        bus.send(can.Message(arbitration_id=0x78, data=b"to us", is_extended_id=False))
        assert [(f.can_id, f.data) for f in collect(port, 1)] == [(0x78, b"to us")]
    port.close()


def test_the_port_serves_as_a_python_can_bus(vcan: str) -> None:
    import can

    from eps_hil.bus.socketcan_bus import SocketCanBus

    with SocketCanBus(vcan, fd=True) as ours, SocketCanBus(vcan, fd=True) as other:
        sent = can.Message(arbitration_id=0x18FF0000, data=bytes(range(12)), is_fd=True)
        ours.send(sent)
        got = other.recv(2.0)
        assert got is not None
        assert got.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)
        assert ours.recv(0.0) is None
        notifier_reader = can.BufferedReader()
        notifier = can.Notifier(other, [notifier_reader])
        ours.send(sent)
        assert notifier_reader.get_message(2.0) is not None
        notifier.stop()


@pytest.mark.parametrize("suffix", [".log", ".blf"])
def test_a_log_is_played_onto_the_bus_and_recorded_from_it(
    vcan: str, tmp_path: Path, suffix: str
) -> None:
    out = tmp_path / f"out{suffix}"
    sent = [Frame(k * 100_000, 0x100 + k % 7, struct.pack("<Q", k)) for k in range(500)]
    listener = SocketCanPort(vcan)
    player = SocketCanPort(vcan, receive_ids=[])
    played = replay.replay(sent, player, speed=None)
    channel = Channel(vcan, lambda: listener)
    report = Recorder([channel], Target(out)).run(duration_s=0.5)
    assert played.sent == report.frames == 500
    assert report.lost == 0
    assert [(f.can_id, f.data) for f in replay.read_log(out)] == [(f.can_id, f.data) for f in sent]
    player.close()
