"""Verbs on a bus or a port do a small piece of their work, each within seconds."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.port import open_port
from eps_hil.cli.main import main
from eps_hil.physics.model import load_model

ROOT = Path(__file__).parents[2]
HEAD = 32
"""Bytes of a message to the page that come before its samples (eps_hil/dashboard/wire.py)."""
CHANNEL, PORT = "239.74.163.95", 43195
CONFIG = f"""bus: {{interface: udp_multicast, channel: {CHANNEL}, fd: true,
      options: {{port: {PORT}, hop_limit: 0}}}}
dbc: {ROOT}/dbc/eps_rig.dbc
signals: {ROOT}/configs/eps_rig_signals.yaml
model: {ROOT}/configs/reference_rig.yaml
rig: {{manoeuvre: idle, loop: true}}
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "c.yaml"
    path.write_text(CONFIG)
    return path


@pytest.fixture
def start() -> Iterator[Callable[..., "subprocess.Popen[str]"]]:
    started = []

    def begin(*words: str) -> "subprocess.Popen[str]":
        process = subprocess.Popen(
            [sys.executable, "-m", "eps_hil.cli", *words],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )  # fmt: skip
        started.append(process)
        return process

    yield begin
    for process in started:
        process.kill()
        process.communicate()


def test_dashboard_shows_a_recording(
    config: Path, tmp_path: Path, start: Callable[..., "subprocess.Popen[str]"]
) -> None:
    from websockets.sync.client import connect

    t = np.arange(0.0, 2.0, 1e-3)
    columns = np.column_stack([t, 0.3 * np.sin(6 * t), 20 * np.cos(6 * t)])
    header = "time_s,motor_torque_nm,motor_speed_rad_s"
    recording = tmp_path / "r.csv"
    np.savetxt(recording, columns, delimiter=",", header=header, comments="")
    process = start("dashboard", str(recording), "--config", str(config), "--port", "0")
    assert process.stderr is not None
    address = next(line.split()[1] for line in process.stderr if "http://" in line)
    until_s, page = time.monotonic() + 60.0, b""
    while not page:
        try:
            with urllib.request.urlopen(address, timeout=30) as answer:
                page = answer.read()
        except OSError:
            assert time.monotonic() < until_s, process.poll()
            time.sleep(0.05)
    assert b"dashboard.js" in page
    with connect(address.replace("http", "ws") + "feed", open_timeout=30) as feed:
        feed.send(json.dumps({"view": {"length_s": 2.0, "pixels": 200}}))
        while not isinstance(data := feed.recv(timeout=30), bytes):
            pass
    drawn = np.frombuffer(data[HEAD:], "<f4")
    assert np.nanmax(drawn) == pytest.approx(20.0)  # the speed's greatest
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0


def test_monitor_looks_once(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At a motor torque of 0.25 Nm, and at what does not come."""
    bus = open_port("udp_multicast", CHANNEL, fd=True, options={"port": PORT, "hop_limit": 0})
    torques = FrameEncoder(load_database([ROOT / "dbc" / "eps_rig.dbc"]), "EPS_Torques")
    stopped = threading.Event()

    def send() -> None:
        while not stopped.wait(0.002):
            bus.send(torques.frame({"MotorTorque": 0.25, "TorsionBarTorque": 0.5}))

    sender = threading.Thread(target=send)
    sender.start()
    try:
        assert main(["monitor", "--config", str(config), "--once", "--seconds", "0.6"]) == 0
    finally:
        stopped.set()
        sender.join()
        bus.close()
    rows = {
        words[0]: words for line in capsys.readouterr().out.splitlines() if (words := line.split())
    }
    assert rows["motor_torque_nm"][1:3] == ["0.2500", "Nm"]
    assert rows["torque_sensor_nm"][1:3] == ["0.5000", "Nm"]
    assert "never" in rows["motor_speed_rad_s"]


def test_programme_measures_the_friction_of_two_cells(
    config: Path, tmp_path: Path, start: Callable[..., "subprocess.Popen[str]"]
) -> None:
    plan, out, result = tmp_path / "plan.yaml", tmp_path / "out", tmp_path / "r.json"
    plan.write_text(
        "programme: {name: one_speed, speeds_rad_s: [20.0], preloads_n: [0.0], repetitions: 1,\n"
        "            run_s: 0.2, settle_s: 0.1, order: as_written}\n"
    )
    rig = start("rig", "--config", str(config))
    listener = open_port("udp_multicast", CHANNEL, fd=True, options={"port": PORT, "hop_limit": 0})
    until_s = time.monotonic() + 90.0  # with a cold compiler cache
    while not listener.recv(0.2):
        assert rig.poll() is None, rig.communicate()
        assert time.monotonic() < until_s
    listener.close()
    words = ["programme", str(plan), "--config", str(config), "--out", str(out), "--cells-only"]
    assert main([*words, "--json", str(result)]) == 0
    assert rig.poll() is None
    cells = json.loads(result.read_text())["cells"]
    friction = load_model(ROOT / "configs" / "reference_rig.yaml").friction
    for cell, offset_nm in zip(
        cells, (friction.offset_pos_nm, -friction.offset_neg_nm), strict=True
    ):
        assert cell["mean_speed_rad_s"] == pytest.approx(cell["speed_rad_s"], rel=0.1)
        assert cell["friction_nm"] == pytest.approx(offset_nm, rel=0.25)
    assert len(list(out.glob("cell_*.log"))) == 2
    assert (out / "cells.csv").read_text().count("\n") == 3
