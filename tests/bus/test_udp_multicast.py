"""The bus of machines without CAN: python-can's wire format, our own sockets."""

import asyncio
import os
import shutil
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.bus.envelopes import Envelopes, Kind
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Port, PortCounts, open_port
from eps_hil.bus.udp_multicast import encode
from eps_hil.errors import BusError

GROUP = "239.74.163.2"
Collect = Callable[[Port, int], list[Frame]]
SendAll = Callable[[Port, Iterable[Frame]], None]


def opened(port: int, **more: object) -> Port:
    options = {"port": port, "hop_limit": 0} | dict(more)
    return open_port("udp_multicast", GROUP, fd=True, options=options)


ECHO = """
import sys
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import open_port
port = open_port("udp_multicast", sys.argv[1], fd=True,
                 options={"port": int(sys.argv[2]), "hop_limit": 0})
print("ready", flush=True)
seen = 0
while seen < 200:
    for frame in port.recv(5.0) or sys.exit("nothing came"):
        assert frame.can_id < 0x300, "an own frame came back"
        seen += 1
        port.send(Frame(0, frame.can_id + 0x200, frame.data))
print(port.counts.received, flush=True)
"""


def test_two_processes_see_each_other_and_not_themselves(udp_port: int, collect: Collect) -> None:
    ours = opened(udp_port)
    words = [sys.executable, "-c", ECHO, GROUP, str(udp_port)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "ready\n"
        for k in range(200):
            assert ours.send(Frame(0, 0x100 + k % 8, struct.pack("<I", k)))
        got = collect(ours, 200)
        assert other.stdout.readline() == "200\n"
    assert [(f.can_id, f.data) for f in got] == [
        (0x300 + k % 8, struct.pack("<I", k)) for k in range(200)
    ]
    assert ours.counts == PortCounts(received=200, sent=200)
    ours.close()


def test_python_can_is_a_peer_both_ways(udp_port: int, collect: Collect) -> None:
    import can

    ours = opened(udp_port)
    with can.Bus(interface="udp_multicast", channel=GROUP, port=udp_port, hop_limit=0) as bus:
        before_ns = time.time_ns()
        ours.send(Frame(0, 0x18FF1234, bytes(range(64)), extended=True, fd=True, brs=True))
        message = bus.recv(2.0)
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (0x18FF1234, bytes(range(64)))
        assert message.is_fd
        assert message.bitrate_switch
        bus.send(can.Message(arbitration_id=0x77, data=b"to us", is_extended_id=False))
        (frame,) = collect(ours, 1)
    assert (frame.can_id, frame.data, frame.extended) == (0x77, b"to us", False)
    assert before_ns <= frame.t_ns <= time.time_ns()
    ours.close()


def test_the_loop_gets_batches_only_of_the_ids_asked_for(udp_port: int, send_all: SendAll) -> None:
    batches: list[list[Frame]] = []

    async def run() -> None:
        options = {"port": udp_port, "hop_limit": 0}
        ours = open_port("udp_multicast", GROUP, receive_ids=[0x10], options=options)
        other = opened(udp_port)
        ours.start(asyncio.get_running_loop(), batches.append)
        send_all(other, (Frame(0, 0x10 + k % 2, bytes([k])) for k in range(100)))
        other.send(Frame(0, 0x10, bytes(12), fd=True))  # ours is not open for FD
        other.send(Frame(0, 0x10, b"end"))
        for _ in range(100):
            await asyncio.sleep(0.02)
            if batches and batches[-1][-1].data == b"end":
                break
        assert ours.state is BusState.ERROR_ACTIVE
        ours.close()
        ours.close()
        other.close()

    asyncio.run(run())
    got = [frame.data for batch in batches for frame in batch]
    assert got == [bytes([k]) for k in range(0, 100, 2)] + [b"end"]


def test_loss_in_the_kernel_is_counted_to_the_frame(udp_port: int, send_all: SendAll) -> None:
    slow, fast = opened(udp_port, receive_buffer_bytes=20_000), opened(udp_port)
    send_all(fast, [Frame(0, 1, bytes(8))] * 500)
    got = len(slow.recv(0.5))
    assert 0 < got < 500
    assert slow.counts.lost_in_kernel == 500 - got
    slow.close()
    fast.close()
    assert slow.counts.lost_in_kernel == 500 - got  # still told after closing


@pytest.mark.parametrize("junk", [b"", b"\x00", b"\x80", b"\x81\xa1a\x01", os.urandom(200)])
def test_datagrams_that_are_no_can_frames_are_left_aside(
    udp_port: int, collect: Collect, junk: bytes
) -> None:
    ours, other = opened(udp_port), opened(udp_port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        stranger.sendto(junk, (GROUP, udp_port))
    other.send(Frame(0, 5, b"fine"))
    assert [f.data for f in collect(ours, 1)] == [b"fine"]
    ours.close()
    other.close()


@pytest.mark.parametrize(
    "wrong",
    [
        {"arbitration_id": -1},
        {"arbitration_id": 0x800},
        {"arbitration_id": 1 << 29, "is_extended_id": True},
        {"arbitration_id": float("inf")},
        {"data": bytes(9)},
        {"data": bytes(65), "is_fd": True},
        {"data": 10**18},
    ],
    ids=str,
)
def test_what_no_can_bus_carries_is_left_aside(
    udp_port: int, collect: Collect, wrong: dict[str, Any]
) -> None:
    """A recorder would write a log of it that nobody can read, or end."""
    ours, other = opened(udp_port), opened(udp_port)
    flags = ("is_extended_id", "is_remote_frame", "is_error_frame", "is_fd", "bitrate_switch")
    fields = {"arbitration_id": 5, "data": b"", **dict.fromkeys(flags, False), **wrong}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        stranger.sendto(msgpack.packb(fields), (GROUP, udp_port))
    other.send(Frame(0, 5, b"fine"))
    assert [f.data for f in collect(ours, 1)] == [b"fine"]
    ours.close()
    other.close()


@given(
    st.integers(0, 0x1FFF_FFFF),
    st.binary(max_size=64),
    st.tuples(*[st.booleans()] * 5),
    st.floats(0, 2e9),
)
def test_bytes_are_those_of_msgpack_for_the_whole_message(
    can_id: int, data: bytes, flags: tuple[bool, bool, bool, bool, bool], now_s: float
) -> None:
    extended, remote, error, fd, brs = flags
    frame = Frame(0, can_id, data, extended, fd, error, False, remote, brs)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("time.time", lambda: now_s)
        sent = encode(frame)
    assert sent == msgpack.packb(
        {
            "timestamp": now_s,
            "arbitration_id": can_id,
            "is_extended_id": extended,
            "is_remote_frame": remote,
            "is_error_frame": error,
            "channel": None,
            "dlc": len(data),
            "data": data,
            "is_fd": fd,
            "bitrate_switch": brs,
            "error_state_indicator": False,
        }
    )


def test_an_urgent_frame_is_handed_over_at_once_and_an_old_one_with_its_queue(
    udp_port: int, send_all: SendAll
) -> None:
    ours, other = opened(udp_port), opened(udp_port)
    ours.urgent_id = 7  # type: ignore[attr-defined]
    send_all(other, (Frame(0, can_id, b"") for can_id in (1, 7, 2, 7, 3)))
    time.sleep(0.01)  # they have waited: all that is there, at once
    assert [f.can_id for f in ours.recv(1.0)] == [1, 7, 2, 7, 3]
    fresh = [other.send(Frame(0, 7, b"")) and [f.can_id for f in ours.recv(1.0)] for _ in range(50)]
    assert fresh == [[7]] * 50
    ours.close()
    other.close()


def test_only_configured_ids_are_sent(udp_port: int) -> None:
    options = {"port": udp_port, "hop_limit": 0}
    port = open_port("udp_multicast", GROUP, send_ids=[1], options=options)
    assert port.send(Frame(0, 1, b""))
    with pytest.raises(BusError, match="not configured to send id 0x2"):
        port.send(Frame(0, 2, b""))
    with pytest.raises(BusError, match="fd: true"):
        port.send(Frame(0, 1, bytes(12), fd=True))
    port.close()
    with pytest.raises(BusError, match="closed"):
        port.send(Frame(0, 1, b""))
    with pytest.raises(BusError, match="closed"):
        port.recv(0.0)


@pytest.mark.parametrize(
    ("channel", "options", "said"),
    [
        ("vcan0", {}, "not a multicast address"),
        ("10.0.0.1", {}, "not a multicast address"),
        (GROUP, {"bitrate": 500_000}, "no option 'bitrate'; known: hop_limit, port"),
        (GROUP, {"port": "x"}, "does not fit"),
        (GROUP, {"port": 99_999}, "does not fit"),
    ],
)
def test_what_cannot_be_opened_names_the_remedy(
    channel: str, options: dict[str, object], said: str
) -> None:
    with pytest.raises(BusError, match=said):
        open_port("udp_multicast", channel, options=options)


NO_NETWORK = """
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import open_port
a, b = (open_port("udp_multicast", "239.74.163.2", options={"port": 43113}) for _ in "ab")
a.send(Frame(0, 1, b"x"))
print([f.data for f in b.recv(2.0)], a.recv(0.1))
"""


def in_a_network_of_its_own(script: str) -> subprocess.CompletedProcess[str]:
    """Run Python where there is nothing but loopback, and root; skips where that is refused."""
    cage = ["unshare", "--net", "--map-root-user"]
    if shutil.which("unshare") is None or subprocess.run([*cage, "true"], check=False).returncode:
        pytest.skip("no rights to make a network namespace (unshare --net); run as root")
    inside = 'ip link set lo up && exec "$0" -c "$1"'
    words = [*cage, "sh", "-c", inside, sys.executable, script]
    return subprocess.run(words, check=False, capture_output=True, text=True, timeout=60)


def test_loopback_serves_where_there_is_no_network() -> None:
    run = in_a_network_of_its_own(NO_NETWORK)
    assert run.stdout == "[b'x'] []\n", run.stderr


def test_a_known_envelope_says_what_unpacking_says(udp_port: int, collect: Collect) -> None:
    """The short way of a datagram seen before, against what was sent, payloads of every kind."""
    import can

    frames = [
        Frame(
            0, 0x100 + k % 3, bytes(((k * 7 + j) % 256) for j in range(k % 9)), extended=k % 2 > 0
        )
        for k in range(90)
    ] + [Frame(0, 0x155, b"\xa4data\xc4\x08", fd=True, brs=True)] * 3
    ours = opened(udp_port)
    with can.Bus(interface="udp_multicast", channel=GROUP, port=udp_port, hop_limit=0) as peer:
        for frame in frames:
            peer.send(
                can.Message(
                    arbitration_id=frame.can_id,
                    data=frame.data,
                    is_extended_id=frame.extended,
                    is_fd=frame.fd,
                    bitrate_switch=frame.brs,
                )
            )
        got = collect(ours, len(frames))
    ours.close()
    assert [replace(frame, t_ns=0) for frame in got] == frames


def test_a_request_carries_no_data(udp_port: int, collect: Collect) -> None:
    """Whatever its datagram holds: on a wire it has none."""
    ours, other = opened(udp_port), opened(udp_port)
    other.send(Frame(0, 0x101, b"12345678", remote=True))
    (got,) = collect(ours, 1)
    assert (got.remote, got.data) == (True, b"")
    ours.close()
    other.close()


def test_envelopes_are_few_and_never_of_errors_or_requests() -> None:
    seen = Envelopes()
    for can_id in range(3_000):
        frame = Frame(0, can_id, bytes(8), extended=True)
        data = encode(frame)
        seen.learn(data, frame, True)
        found = seen.look(encode(replace(frame, data=b"12345678")))
        assert found is None or found == (Kind(can_id, True, False, False, True), b"12345678")
        assert (found is not None) == (can_id < 1_000)
    fresh = Envelopes()
    for frame in (Frame(0, 1, b"", remote=True), Frame(0, 1, bytes(8), error=True)):
        fresh.learn(encode(frame), frame, True)
        assert fresh.look(encode(frame)) is None
