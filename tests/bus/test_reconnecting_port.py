"""A port that outlives its bus: losses are survived, said and counted."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Deliver, OnLost, Port, PortCounts, open_port
from eps_hil.bus.reconnecting_port import ReconnectingPort
from eps_hil.errors import AbsentBusError, BusError

from .test_udp_multicast import GROUP, in_a_network_of_its_own


class Fragile:
    """A port whose bus goes when the test says so."""

    def __init__(self) -> None:
        self.name = "fragile:0"
        self.gone = self.closed = False
        self.sent = 0

    @property
    def counts(self) -> PortCounts:
        return PortCounts(received=1, sent=self.sent)

    @property
    def state(self) -> BusState:
        return BusState.LOST if self.gone else BusState.ERROR_ACTIVE

    def start(self, loop: object, deliver: Deliver, on_lost: OnLost | None = None) -> None:
        raise NotImplementedError

    def send(self, frame: Frame) -> bool:
        if frame.can_id == 0x7FF:
            raise BusError("fragile:0: not configured to send id 0x7FF")
        if self.gone:
            raise BusError("fragile:0: the interface went down")
        self.sent += 1
        return True

    def recv(self, timeout_s: float) -> list[Frame]:
        if self.gone:
            raise BusError("fragile:0: the interface went down")
        return [Frame(1, 2, b"")]

    def close(self) -> None:
        self.closed = True


class Bench:
    def __init__(self) -> None:
        self.made: list[Fragile] = []
        self.refuse = 0
        self.said: list[str] = []
        self.port = ReconnectingPort(self.open, self.said.append, pause_s=0.05)

    def open(self) -> Port:
        if self.refuse:
            self.refuse -= 1
            raise BusError("fragile:0: no such interface")
        self.made.append(Fragile())
        return self.made[-1]


def test_a_lost_bus_is_silence_until_it_is_back() -> None:
    bench = Bench()
    port = bench.port
    assert len(port.recv(0.0)) == 1
    bench.made[0].gone, bench.refuse = True, 2
    assert port.recv(0.0) == []
    assert bench.made[0].closed
    assert str(port.state) == "lost"
    assert not port.send(Frame(0, 1, b""))
    start_s = time.monotonic()
    assert len(port.recv(5.0)) == 1  # within it: two refusals, then it is there
    assert 0.1 <= time.monotonic() - start_s < 2.0
    assert port.state is BusState.ERROR_ACTIVE
    assert port.send(Frame(0, 1, b""))
    assert [line.split("  ")[0] for line in bench.said] == ["bus lost", "bus back"]
    assert "went down" in bench.said[0]
    (outage,) = port.outages
    assert 0 < outage.since_ns < outage.until_ns
    # both openings' counts, and what was to be sent while there was none
    assert port.counts == PortCounts(received=2, sent=1, send_dropped=1)


def test_a_loss_that_sending_notices_is_survived_too() -> None:
    bench = Bench()
    bench.made[0].gone = True
    assert not bench.port.send(Frame(0, 1, b""))
    assert bench.made[0].closed
    assert bench.port.counts.send_dropped == 1
    assert len(bench.port.recv(1.0)) == 1


def test_waiting_for_a_bus_takes_no_longer_than_asked() -> None:
    bench = Bench()
    bench.made[0].gone, bench.refuse = True, 1000
    bench.port.recv(0.0)
    start_s = time.monotonic()
    assert bench.port.recv(0.12) == []
    assert 0.1 <= time.monotonic() - start_s < 1.0


def test_an_id_that_may_not_be_sent_is_no_loss() -> None:
    bench = Bench()
    with pytest.raises(BusError, match="not configured"):
        bench.port.send(Frame(0, 0x7FF, b""))
    assert bench.said == []


def test_an_interface_that_is_not_there_yet_is_waited_for() -> None:
    missing = [2]
    said: list[str] = []

    def opener() -> Port:
        if missing[0]:
            missing[0] -= 1
            raise AbsentBusError("can0: no such interface; there is vcan0")
        return Fragile()

    port = ReconnectingPort(opener, said.append, pause_s=0.05, name="socketcan can0")
    assert port.name == "socketcan can0"
    assert port.recv(0.0) == []
    assert not port.send(Frame(0, 1, b""))
    assert len(port.recv(5.0)) == 1
    assert said == [
        "bus absent can0: no such interface; there is vcan0; waiting for it (bus.reconnect)",
        "bus back   going on",
    ]
    (outage,) = port.outages
    assert 0 < outage.since_ns < outage.until_ns


def test_any_other_first_opening_has_to_work_and_a_closed_port_stays_closed() -> None:
    with pytest.raises(BusError, match="not a multicast address"):
        ReconnectingPort(lambda: open_port("udp_multicast", "10.0.0.1"))
    bench = Bench()
    bench.port.close()
    bench.port.close()
    with pytest.raises(BusError, match="closed"):
        bench.port.recv(0.0)


REMADE = """
import subprocess, sys
from eps_hil.bus.reconnecting_port import ReconnectingPort
from eps_hil.bus.port import open_port

def run(*words):
    subprocess.run(words, check=True)

other = subprocess.Popen(["unshare", "--net", "sleep", "50"])  # the network of a second machine
there = ["nsenter", "-t", str(other.pid), "-n"]

def make():
    run("ip", "link", "add", "a0", "type", "veth", "peer", "name", "b0")
    while subprocess.run(["ip", "link", "set", "b0", "netns", str(other.pid)]).returncode:
        pass  # it is not there yet
    for side, name, address in (([], "a0", "10.9.0.1/24"), (there, "b0", "10.9.0.2/24")):
        run(*side, "ip", "addr", "add", address, "dev", name)
        run(*side, "ip", "link", "set", name, "up")
        run(*side, "ip", "route", "add", "224.0.0.0/4", "dev", name)

TALK = '''
import time
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import open_port
port = open_port("udp_multicast", GROUP, options={"port": 43113, "hop_limit": 1})
for k in range(100):
    port.send(Frame(0, 1, b"there"))
    time.sleep(0.05)
'''
make()
try:
    listener = ReconnectingPort(lambda: open_port("udp_multicast", GROUP, options={"port": 43113}))
    for change in ("plugged", "down", "removed"):
        if change == "down":
            run("ip", "link", "set", "a0", "down")
            run("ip", "link", "set", "a0", "up")
        elif change == "removed":
            run("ip", "link", "del", "a0")
            make()
        talker = subprocess.Popen([*there, sys.executable, "-c", TALK])
        print(change, any(listener.recv(0.2) for _ in range(25)))
        talker.kill()
        talker.wait()
        listener.recv(0.0)
finally:
    other.kill()
    other.wait()
"""


@pytest.mark.slow
def test_udp_multicast_survives_an_interface_that_is_down_or_made_anew() -> None:
    run = in_a_network_of_its_own(REMADE.replace("GROUP", repr(GROUP)))
    assert run.stdout == "plugged True\ndown True\nremoved True\n", run.stderr


@pytest.mark.socketcan
def test_a_can_interface_goes_down_and_is_made_anew(brief_vcan: str) -> None:
    said: list[str] = []

    def opener() -> Port:
        return open_port("socketcan", brief_vcan)

    def ip(*words: str) -> None:
        subprocess.run(["ip", "link", *words], check=True)

    port = ReconnectingPort(opener, said.append, pause_s=0.1)
    ip("set", brief_vcan, "down")
    assert port.recv(0.3) == []
    ip("set", brief_vcan, "up")
    port.recv(1.0)
    ip("del", brief_vcan)
    assert not port.send(Frame(0, 1, b""))
    ip("add", "dev", brief_vcan, "type", "vcan")
    ip("set", brief_vcan, "up")
    until_s = time.monotonic() + 10.0
    while port.state is BusState.LOST and time.monotonic() < until_s:
        port.recv(0.1)
    subprocess.run(["cansend", brief_vcan, "123#AB"], check=True)
    assert [f.can_id for f in port.recv(2.0)] == [0x123]
    assert [line.split("  ")[0] for line in said] == ["bus lost", "bus back"] * 2
    assert "went down" in said[0]
    port.close()


@pytest.mark.socketcan
@pytest.mark.slow
def test_a_rig_outlives_its_interface(brief_vcan: str, tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    config = tmp_path / "c.yaml"
    config.write_text(
        f"bus: {{interface: socketcan, channel: {brief_vcan}}}\ndbc: {root}/dbc/eps_rig.dbc\n"
        f"signals: {root}/configs/eps_rig_signals.yaml\nmodel: {root}/configs/reference_rig.yaml\n"
    )
    words = [sys.executable, "-m", "eps_hil.cli", "rig", "--config", str(config), "--duration", "8"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as rig:
        assert rig.stdout is not None
        for line in rig.stdout:
            if line.startswith("timing"):
                break
        subprocess.run(["ip", "link", "set", brief_vcan, "down"], check=True)
        time.sleep(1.5)
        subprocess.run(["ip", "link", "set", brief_vcan, "up"], check=True)
        said = rig.stdout.read()
    assert rig.returncode == 0, said
    assert "bus lost   " in said
    assert "bus back   " in said
