"""``eps-hil investigate`` against ``eps-hil rig``, two processes: kill -9 and Ctrl-C."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from eps_hil.bus.database import load_database
from eps_hil.bus.port import Port, open_port

from .bench import ROOT, written

CHANNEL, OPTIONS = "239.74.163.93", {"port": 43193, "hop_limit": 0}
BUS = (
    f"{{interface: udp_multicast, channel: {CHANNEL}, fd: true, "
    "options: {port: 43193, hop_limit: 0}}"
)
DATABASE = load_database([ROOT / "dbc" / "eps_rig.dbc"])


def start(*words: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-m", "eps_hil.cli", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )


@pytest.fixture
def listener() -> Iterator[Port]:
    port = open_port("udp_multicast", CHANNEL, fd=True, options=OPTIONS)
    yield port
    port.close()


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return written(tmp_path, BUS)


@pytest.fixture
def rig(config: Path, listener: Port) -> Iterator["subprocess.Popen[str]"]:
    process = start("rig", "--config", str(config))
    end = time.monotonic() + 90  # with a cold compiler cache
    while not listener.recv(0.2):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
    yield process
    process.kill()
    process.communicate()


def heard(listener: Port, seconds: float) -> tuple[float, list[float]]:
    """The newest rotor speed of so long a time, and every share for the motor in a command."""
    while listener.recv(0.0):
        pass
    end, speed, shares = time.monotonic() + seconds, 0.0, []
    while time.monotonic() < end:
        for frame in listener.recv(0.05):
            if frame.can_id == 0x100:
                speed = DATABASE.decode_message(0x100, frame.data)["MotorSpeed"]
            if frame.can_id == 0xA0:
                shares.append(DATABASE.decode_message(0xA0, frame.data)["MotorShare"])
            assert frame.can_id != 0x80, "nobody has armed anything"
    return speed, shares


def wait_until_moving(listener: Port, process: "subprocess.Popen[str]") -> list[float]:
    end, shares = time.monotonic() + 90, []
    while True:
        speed, more = heard(listener, 0.05)
        shares += more
        if abs(speed) > 5.0:
            return shares
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end


@pytest.mark.flaky(reruns=2)  # a machine that stands still for 50 ms ends a run, and rightly
@pytest.mark.slow
def test_killed_or_interrupted_it_leaves_a_rig_at_rest(
    config: Path, rig: "subprocess.Popen[str]", listener: Port, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    words = ["investigate", "--config", str(config), "--out", str(out), "--budget", "1h"]
    killed = start(*words)
    shares = wait_until_moving(listener, killed)
    killed.kill()
    killed.communicate()
    time.sleep(0.6)
    assert abs(heard(listener, 0.05)[0]) < 1.0, "the rig stops by itself"
    assert not list(out.glob("step_*.json"))

    stopped = start(*words)
    shares += wait_until_moving(listener, stopped)
    stopped.send_signal(signal.SIGINT)
    _, told = stopped.communicate(timeout=20)
    assert stopped.returncode == 1
    assert "call again to go on" in told
    assert told.count("\n") == 1
    assert abs(heard(listener, 0.05)[0]) < 1.0, "it brought the rig to rest"

    assert set(shares) == {0.0}, "no torque of the motor was ever asked for"
    assert rig.poll() is None
