"""Buses to test on: vcan0 where the kernel has CAN, a multicast port of its own everywhere."""

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator

import pytest

from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port

GROUP = "239.74.163.2"


def missing_vcan() -> str:
    """What keeps vcan0 from being used, with the remedy; empty if nothing."""
    how = (
        "run scripts/ci/with-vcan.sh .venv/bin/pytest -m socketcan "
        "(makes vcan0, or boots User-Mode Linux: apt-get install user-mode-linux)"
    )
    try:
        with socket.socket(29, socket.SOCK_RAW, 1) as bus:  # AF_CAN, CAN_RAW
            bus.bind(("vcan0",))
    except OSError as error:
        return f"no vcan0 on this machine ({error.strerror}); {how}"
    absent = [tool for tool in ("candump", "cansend") if shutil.which(tool) is None]
    return f"{absent[0]} is missing; apt-get install can-utils" if absent else ""


@pytest.fixture
def vcan() -> str:
    """Name of a virtual CAN FD interface; skips loudly, or fails if CI asked for it."""
    missing = missing_vcan()
    if missing and os.environ.get("EPS_HIL_REQUIRE_SOCKETCAN") == "1":
        pytest.fail(missing)
    if missing:
        pytest.skip(missing)
    return "vcan0"


@pytest.fixture
def brief_vcan(vcan: str) -> Iterator[str]:
    """An interface of its own that a test may take away; needs root, as ip link does."""
    name = "vcan7"
    made = subprocess.run(
        ["ip", "link", "add", "dev", name, "type", "vcan"],
        check=False,
        capture_output=True,
        text=True,
    )
    if made.returncode and os.environ.get("EPS_HIL_REQUIRE_SOCKETCAN") == "1":
        pytest.fail(made.stderr)
    if made.returncode:
        pytest.skip(f"cannot make {name}: {made.stderr.strip()}; run the tests as root")
    subprocess.run(["ip", "link", "set", name, "up"], check=True)
    yield name
    subprocess.run(["ip", "link", "del", name], check=False, capture_output=True)


@pytest.fixture
def udp_port() -> int:
    """A UDP port that nothing else on this machine uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def collect() -> Callable[[Port, int], list[Frame]]:
    """Receive ``count`` frames, or what came within five seconds."""

    def collected(port: Port, count: int) -> list[Frame]:
        frames: list[Frame] = []
        until = time.monotonic() + 5.0
        while len(frames) < count and time.monotonic() < until:
            frames += port.recv(0.1)
        return frames

    return collected


@pytest.fixture
def send_all() -> Callable[[Port, Iterable[Frame]], None]:
    """Send every frame, waiting where the kernel's queue is full: ``Port.send`` then drops it."""

    def sent(port: Port, frames: Iterable[Frame]) -> None:
        until = time.monotonic() + 20.0
        for frame in frames:
            while not port.send(frame):
                assert time.monotonic() < until, "the queue stays full"
                time.sleep(0.001)

    return sent
