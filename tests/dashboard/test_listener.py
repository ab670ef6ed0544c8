"""The listener never waits for the server, and says in words what is missing."""

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, PortCounts
from eps_hil.dashboard.listener import Listener, Outlet, listen
from eps_hil.dashboard.marks import Marks, marks_path
from eps_hil.dashboard.store import Block, Store
from eps_hil.dashboard.traces import NAMES
from eps_hil.dashboard.wire import unpack
from eps_hil.dashboard.words import problems
from eps_hil.errors import InputError
from eps_hil.service.config import load_config

ROOT = Path(__file__).parents[2]
Blocks = Callable[[float, float], dict[str, Block]]


@pytest.fixture
def pair() -> tuple[socket.socket, socket.socket]:
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def test_a_server_that_reads_nothing_costs_the_oldest_and_no_time(
    pair: tuple[socket.socket, socket.socket], blocks: Blocks
) -> None:
    outlet = Outlet(pair[0])
    for k in range(1000):
        outlet.samples(blocks(0.04 * k, 0.04 * (k + 1)))
        assert outlet.flush(), "somebody is there, only slow"
    assert outlet.dropped > 500
    pair[1].close()
    assert not outlet.flush(), "nobody is there any more"
    pair[0].close()


def test_a_long_stretch_travels_in_pieces(
    pair: tuple[socket.socket, socket.socket], blocks: Blocks
) -> None:
    outlet, store = Outlet(pair[0]), Store()
    outlet.samples(blocks(0.0, 4.0))
    pair[1].setblocking(False)
    while True:
        try:
            message = pair[1].recv(1 << 20)
        except BlockingIOError:
            if not outlet._pending:
                break
            outlet.flush()
            continue
        assert message[:1] == b"S"
        store.append(unpack(message[1:]))
    assert [len(store.tracks[name].t_ns) for name in NAMES] == [4000] * 8
    for each in pair:
        each.close()


class SilentPort:
    """A bus without frames."""

    name, counts, state = "silent", PortCounts(), BusState.UNKNOWN
    closed = False

    def recv(self, timeout_s: float) -> list[object]:
        return []

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "c.yaml"
    path.write_text(f"""bus: {{interface: virtual, channel: page-test}}
dbc: [{ROOT}/dbc/eps_rig.dbc]
signals: {ROOT}/configs/eps_rig_signals.yaml
model: {ROOT}/configs/reference_rig.yaml
""")
    return path


def test_what_compiles_ends_with_the_listener(
    config: Path, pair: tuple[socket.socket, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("eps_hil.dashboard.listener._WARM", "import time; time.sleep(600)")
    monkeypatch.setattr("eps_hil.compiled.FOLDER", config.parent)
    listener = Listener(load_config(config))
    listener.warm_up()
    until_s = time.monotonic() + 60
    while listener._compiling is None and time.monotonic() < until_s:
        time.sleep(0.01)
    assert listen(listener, SilentPort(), Outlet(pair[0]), lambda: True)  # type: ignore[arg-type]
    assert listener._compiling is not None
    assert listener._compiling.wait(60) < 0
    for each in pair:
        each.close()


def test_a_silent_bus_is_said_in_words(
    config: Path, pair: tuple[socket.socket, socket.socket]
) -> None:
    listener, port = Listener(load_config(config)), SilentPort()
    turns = iter([False, True])
    assert listen(listener, port, Outlet(pair[0]), lambda: next(turns))  # type: ignore[arg-type]
    assert port.closed
    state = json.loads(pair[1].recv(1 << 20)[1:])
    (said,) = state["problems"]
    assert said.startswith(
        "waiting for frames of EPS_Torques (id 0x101), EPS_MotorState (id 0x100)"
    )
    assert "is the rig there?" in said
    assert state["estimate"]["status"] == "silent"
    for each in pair:
        each.close()


class BusyPort(SilentPort):
    """A bus on which a frame waits at every look."""

    def __init__(self) -> None:
        self.waits: list[float] = []

    def recv(self, timeout_s: float) -> list[object]:
        self.waits.append(timeout_s)
        return [Frame(time.time_ns(), 0x7FF, b"")]


def test_no_frame_wakes_it_it_looks_a_hundred_times_a_second(
    config: Path, pair: tuple[socket.socket, socket.socket]
) -> None:
    listener, port = Listener(load_config(config)), BusyPort()
    end_s = time.monotonic() + 0.5
    assert listen(listener, port, Outlet(pair[0]), lambda: time.monotonic() > end_s)  # type: ignore[arg-type]
    assert set(port.waits) == {0.0}
    assert 2 < len(port.waits) <= 50 + 4, "and once more before each of the figures"
    for each in pair:
        each.close()


@pytest.mark.slow
def test_it_takes_no_core_from_what_runs() -> None:
    said = subprocess.run(
        [sys.executable, "-c", "import os; from eps_hil.dashboard.listener import stand_back\n"
         "stand_back(); print(os.sched_getscheduler(0))"],
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert int(said) == os.SCHED_BATCH


def test_a_lost_bus_and_a_service_that_is_not_there_are_said(config: Path) -> None:
    listener = Listener(load_config(config))
    figures = listener.monitor.figures(1_000_000_000, loading=True)
    said = problems(figures, listener.sources, listener.estimate, "can0: network is down")
    assert said == ["bus lost: can0: network is down; it is opened again as soon as it is back"]
    few = {"motor_torque_nm": ("EPS_Torques", 0x101)}
    listener.monitor._signals["motor_torque_nm"].take(900_000_000, 0.1)
    figures = listener.monitor.figures(1_000_000_000, loading=True)
    said = problems(figures, few, listener.estimate)
    assert said == [
        "nothing on id 0x120 (EPSHIL_Estimate) yet; is the service (eps-hil run) there?"
    ]
    late = listener.monitor.figures(4_000_000_000, loading=True)
    more = few | {"rack_force_n": ("RIG_State", 0x110)}
    assert problems(late, more, listener.estimate)[:2] == [
        "nothing for 3 s and more: EPS_Torques (id 0x101)",
        "nothing yet: RIG_State (id 0x110)",
    ]


def test_marks_are_appended_beside_the_recording_and_read_again(tmp_path: Path) -> None:
    path = marks_path(tmp_path / "bus.log")
    assert path.name == "bus.log.marks.jsonl"
    marks = Marks(path)
    assert marks.add(1_790_000_000_000_000_000, "a bump\nat  the stop\x00") == ""
    marks.add(5, "x" * 1000)
    again = Marks(path).marks
    assert [mark.text for mark in again] == ["a bump at the stop", "x" * 200]
    assert json.loads(path.read_text().splitlines()[0])["utc"].startswith("2026-09-21T")
    path.write_text('{"t_ns": 1}\n')
    with pytest.raises(InputError, match="line 1: is no mark"):
        Marks(path)
    assert "No such file" in Marks(tmp_path / "gone" / "m.jsonl").add(1, "x")


def test_marks_of_another_encoding_are_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "m.jsonl"
    path.write_bytes('{"t_ns": 5, "text": "Straße"}\n'.encode("latin-1"))
    with pytest.raises(InputError, match=r"m\.jsonl: cannot be read: it is not UTF-8"):
        Marks(path)
