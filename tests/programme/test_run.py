"""``eps-hil programme`` against ``eps-hil rig``, two processes: kill -9, interrupt, resume."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.config import load_bus_setup
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port, open_port
from eps_hil.cli.main import main
from eps_hil.physics.model import load_model
from eps_hil.programme.conductor import Wanted
from eps_hil.programme.link import RigLink
from eps_hil.recordings.read import read_recording

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "configs" / "reference_rig.yaml"
DBC, SIGNALS = ROOT / "dbc" / "eps_rig.dbc", ROOT / "configs" / "eps_rig_signals.yaml"
CHANNEL, OPTIONS = "239.74.163.91", {"port": 43191, "hop_limit": 0}
CONFIG = f"""bus: {{interface: udp_multicast, channel: {CHANNEL}, fd: true,
      options: {{port: 43191, hop_limit: 0}}}}
dbc: {DBC}
signals: {SIGNALS}
model: {ROOT}/configs/reference_rig.yaml
rig: {{manoeuvre: idle, loop: true}}
"""
PLAN = """programme:
  name: two_by_two
  speeds_rad_s: [20.0, 40.0]
  preloads_n: [0.0, 500.0]
  repetitions: 1
  run_s: 0.2
  settle_s: 0.1
  order: as_written
"""
DATABASE = load_database([DBC])
CELLS = 8


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "plan.yaml").write_text(PLAN)
    path = tmp_path / "c.yaml"
    path.write_text(CONFIG)
    return path


def start(*words: str) -> "subprocess.Popen[str]":
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    return subprocess.Popen(
        [sys.executable, "-m", "eps_hil.cli", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )


@pytest.fixture
def rig(config: Path) -> Iterator["subprocess.Popen[str]"]:
    process = start("rig", "--config", str(config))
    yield process
    process.kill()
    process.communicate()


@pytest.fixture
def listener() -> Iterator[Port]:
    port = open_port("udp_multicast", CHANNEL, fd=True, options=OPTIONS)
    yield port
    port.close()


def speed_now(listener: Port) -> float:
    """Rotor speed in the newest frame of the next 50 ms."""
    while listener.recv(0.0):
        pass
    end, speed = time.monotonic() + 0.05, 0.0
    while time.monotonic() < end:
        for frame in listener.recv(0.05):
            if frame.can_id == 0x100:
                speed = DATABASE.decode_message(0x100, frame.data)["MotorSpeed"]
    return speed


def wait_for_cells(out: Path, count: int, process: "subprocess.Popen[str]") -> None:
    end = time.monotonic() + 90
    while len(list(out.glob("cell_*.json"))) < count:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.02)


def wait_until_moving(listener: Port, process: "subprocess.Popen[str]") -> None:
    end = time.monotonic() + 30
    while abs(speed_now(listener)) < 15.0:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end


@pytest.mark.flaky(reruns=2)  # a machine that stands still for 50 ms ends a run, and rightly
@pytest.mark.slow
def test_killed_and_interrupted_it_goes_on_and_finds_the_friction(
    config: Path, rig: "subprocess.Popen[str]", listener: Port, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    words = ["programme", str(tmp_path / "plan.yaml"), "--config", str(config), "--out", str(out)]
    end = time.monotonic() + 90  # with a cold compiler cache
    while not listener.recv(0.2):
        assert rig.poll() is None, rig.communicate()
        assert time.monotonic() < end
    killed = start(*words)
    wait_for_cells(out, 2, killed)
    wait_until_moving(listener, killed)
    killed.kill()
    killed.communicate()
    time.sleep(0.6)
    assert abs(speed_now(listener)) < 1.0, "the rig stops by itself"
    kept = {path: path.read_bytes() for path in out.glob("cell_*.json")}
    assert 2 <= len(kept) < CELLS

    assert main(words) == 2  # finished cells are never overwritten without being asked
    for number in (signal.SIGTERM, signal.SIGHUP):
        there = len(list(out.glob("cell_*.json")))
        stopped = start(*words, "--resume")
        wait_for_cells(out, there + 1, stopped)
        wait_until_moving(listener, stopped)
        stopped.send_signal(number)
        said, told = stopped.communicate(timeout=20)
        assert stopped.returncode == 1
        assert "--resume" in told
        assert told.count("\n") == 1
        assert f"{there} of {CELLS} cells are there already" in said
        assert abs(speed_now(listener)) < 1.0, "it brought the rig to rest"

    model = tmp_path / "found.yaml"
    more = [
        "--resume",
        "--cells-only",
        "--write-model",
        str(model),
        "--json",
        str(tmp_path / "r.json"),
    ]
    last = start(*words, *more)
    said, told = last.communicate(timeout=90)
    assert last.returncode == 0, told
    assert rig.poll() is None
    for path, content in kept.items():
        assert path.read_bytes() == content
    result = json.loads((tmp_path / "r.json").read_text())
    assert len(result["cells"]) == CELLS
    found, truth = load_model(model).friction, load_model(ROOT / "configs/reference_rig.yaml")
    for name in ("offset_pos_nm", "offset_neg_nm"):
        assert getattr(found, name) == pytest.approx(getattr(truth.friction, name), rel=0.15)
    logs = sorted(out.glob("cell_*.log"))
    assert len([log for log in logs if not log.name.endswith(".part.log")]) == CELLS
    recording = read_recording(logs[0], dbc=[DBC], signals=SIGNALS)
    assert {"motor_speed_rad_s", "rack_force_n"} <= set(recording.series)


def test_without_a_rig_it_says_so(
    config: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("eps_hil.programme.link._FIRST_WAIT_S", 0.2)
    silent = config.read_text().replace(CHANNEL, "239.74.163.92").replace("43191", "43192")
    config.write_text(silent)
    words = ["programme", str(tmp_path / "plan.yaml"), "--config", str(config)]
    assert main([*words, "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert "does the rig run?" in said
    assert said.count("\n") == 1


def test_two_programmes_do_not_share_a_rig(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Somebody commands the rig already: not one frame of ours goes out."""
    other = open_port("udp_multicast", CHANNEL, fd=True, options=OPTIONS, never_send_ids=())
    encoder, stopped = FrameEncoder(DATABASE, "RIG_Command"), threading.Event()
    seen: list[int] = []

    def command() -> None:
        while not stopped.wait(0.01):
            other.send(encoder.frame({"CommandRequest": 1.0}))
            seen.extend(frame.can_id for frame in other.recv(0.0))

    thread = threading.Thread(target=command)
    thread.start()
    words = ["programme", str(tmp_path / "plan.yaml"), "--config", str(config)]
    try:
        assert main([*words, "--out", str(tmp_path / "out")]) == 1
    finally:
        stopped.set()
        thread.join()
        other.close()
    assert "another transmitter sends RIG_Command (0xA0)" in capsys.readouterr().err
    assert seen == []


def test_no_set_point_holds_a_torque_of_the_motor(config: Path) -> None:
    """Whoever leads the rig: a share of the preload for the motor is a torque without a guard."""
    link = RigLink(load_bus_setup(config), load_model(REFERENCE))
    sent: list[Frame] = []

    class PortThatKeeps:
        def send(self, frame: Frame) -> bool:
            sent.append(frame)
            return True

    stand_in: Any = PortThatKeeps()
    link._port = stand_in
    for force_n in (0.0, 3000.0, -3000.0):
        link.send(Wanted(5.0, force_n))
    told = [DATABASE.decode_message("RIG_Command", f.data, decode_choices=False) for f in sent]
    assert [each["RackForceSetPoint"] for each in told] == [0.0, 3000.0, -3000.0]
    assert {each["MotorShare"] for each in told} == {0.0}


def test_another_programme_in_the_folder_is_refused(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "programme.json").write_text("{}")
    words = ["programme", str(tmp_path / "plan.yaml"), "--config", str(config), "--out", str(out)]
    assert main([*words, "--resume"]) == 2
    assert "another programme" in capsys.readouterr().err


def test_a_mapping_without_a_load_cell_is_refused(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mapping = tmp_path / "signals.yaml"
    lines = SIGNALS.read_text().splitlines()
    mapping.write_text("\n".join(line for line in lines if "rack_force_n:" not in line))
    config.write_text(config.read_text().replace(str(SIGNALS), str(mapping)))
    words = ["programme", str(tmp_path / "plan.yaml"), "--config", str(config)]
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    assert "rack_force_n" in capsys.readouterr().err
