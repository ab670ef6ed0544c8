"""The service manager's protocol, with a datagram socket in systemd's place."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from eps_hil.service.systemd import Notifier

ROOT = Path(__file__).parents[2]
UNIT = ROOT / "configs" / "systemd" / "eps-hil@.service"


class Manager:
    """Hears what a notifier says."""

    def __init__(self, address: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(address)

    def heard(self, timeout_s: float = 0.5) -> str:
        """The next datagram; empty if none came."""
        self._socket.settimeout(timeout_s)
        try:
            return self._socket.recv(4096).decode()
        except TimeoutError:
            return ""

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    made = Manager(str(tmp_path / "notify"))
    yield made
    made.close()


def test_says_what_a_manager_wants_to_hear(manager: Manager, tmp_path: Path) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "3000000"})
    assert notifier.watchdog_s == 3.0
    assert notifier.feed_s == 1.0
    notifier.ready("1000 steps/s")
    notifier.alive()
    notifier.status("no input")
    notifier.waiting("can0: no such interface")
    notifier.stopping()
    said = [manager.heard() for _ in range(5)]
    waiting = "STATUS=waiting: can0: no such interface\nEXTEND_TIMEOUT_USEC=180000000"
    assert said.pop(3) == waiting
    assert said == ["READY=1\nSTATUS=1000 steps/s", "WATCHDOG=1", "STATUS=no input", "STOPPING=1"]
    notifier.close()
    notifier.alive()
    assert manager.heard(0.05) == ""


def test_an_abstract_socket_is_reached_too() -> None:
    name = f"eps-hil-test-{os.getpid()}"
    manager = Manager("\0" + name)
    Notifier({"NOTIFY_SOCKET": "@" + name}).alive()
    assert manager.heard() == "WATCHDOG=1"
    manager.close()


@pytest.mark.parametrize(
    "environment",
    [
        {},
        {"WATCHDOG_USEC": "1000000"},
        {"NOTIFY_SOCKET": "nowhere", "WATCHDOG_USEC": "1000000"},
        {"NOTIFY_SOCKET": "/x", "WATCHDOG_USEC": "soon"},
        {"NOTIFY_SOCKET": "/x", "WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"},
    ],
)
def test_without_a_manager_or_watchdog_nothing_is_fed(environment: dict[str, str]) -> None:
    notifier = Notifier(environment)
    assert notifier.feed_s == 0.0
    notifier.ready("x")  # nobody listens, and nothing fails


def test_a_manager_that_does_not_read_stops_nobody(manager: Manager, tmp_path: Path) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "notify")})
    start_s = time.monotonic()
    for _ in range(5_000):
        notifier.alive()
    assert time.monotonic() - start_s < 5.0


@pytest.mark.slow
def test_a_service_feeds_while_its_loop_turns_and_no_longer(
    manager: Manager, tmp_path: Path
) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(
        "bus: {interface: udp_multicast, channel: 239.74.163.83, fd: true,\n"
        "      options: {port: 43183, hop_limit: 0}}\n"
        f"dbc: {ROOT}/dbc/eps_rig.dbc\nsignals: {ROOT}/configs/eps_rig_signals.yaml\n"
        f"model: {ROOT}/configs/reference_rig.yaml\n"
    )
    environment = os.environ | {
        "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "300000",
    }  # fmt: skip
    words = [sys.executable, "-m", "eps_hil.cli", "run", "--config", str(config)]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, env=environment) as service:
        try:
            first = manager.heard(240.0)  # a first start compiles
            assert first.startswith("READY=1\nSTATUS=")
            fed = [manager.heard(2.0) for _ in range(4)]
            assert fed.count("WATCHDOG=1") >= 2
            service.send_signal(signal.SIGSTOP)  # a loop that hangs
            while manager.heard(0.3):
                pass
            assert manager.heard(1.0) == ""
            service.send_signal(signal.SIGCONT)
            assert manager.heard(5.0) in {"WATCHDOG=1", "STATUS=0 steps/s, no input, 0 steps"}
            service.terminate()
            said = [manager.heard(5.0) for _ in range(10)]
            assert "STOPPING=1" in said
        finally:
            service.kill()


def test_the_unit_is_one_that_systemd_takes(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    text = UNIT.read_text().replace("/opt/eps-hil/bin/eps-hil", sys.executable)
    (tmp_path / UNIT.name).write_text(text)
    words = ["systemd-analyze", "verify", str(tmp_path / UNIT.name)]
    run = subprocess.run(words, check=False, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert "Unknown" not in run.stderr


def test_the_unit_gives_what_the_service_asks_for() -> None:
    lines = UNIT.read_text().splitlines()
    for line in (
        "Type=notify", "WatchdogSec=5", "Restart=on-failure", "RestartPreventExitStatus=2",
        "LimitRTPRIO=50", "LimitMEMLOCK=infinity",
    ):  # fmt: skip
        assert line in lines
