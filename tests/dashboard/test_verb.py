"""``eps-hil dashboard`` as a user meets it."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.port import open_port
from eps_hil.cli.main import main

ROOT = Path(__file__).parents[2]
CHANNEL, PORT = "239.74.163.94", 43194
CONFIG = f"""bus: {{interface: udp_multicast, channel: {CHANNEL}, fd: true,
      options: {{port: {PORT}, hop_limit: 0}}}}
dbc: {ROOT}/dbc/eps_rig.dbc
signals: {ROOT}/configs/eps_rig_signals.yaml
model: {ROOT}/configs/reference_rig.yaml
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "c.yaml"
    path.write_text(CONFIG)
    return path


@pytest.mark.parametrize("library", ["uvicorn", "jinja2"])
def test_without_the_extra_one_line_before_anything_else(
    library: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """jinja2: the report of a stretch that is diagnosed, which would end without one."""
    there = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *r: None if name == library else there(name)
    )
    assert main(["dashboard", "--config", str(tmp_path / "not_there.yaml")]) == 2
    said = capsys.readouterr().err
    assert 'pip install "eps_hil[dashboard]"' in said
    assert said.count("\n") == 1


def test_what_is_wrong_is_one_line(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dashboard", "--config", str(config), "gone.log"]) == 2
    assert "gone.log: no such file" in capsys.readouterr().err.splitlines()[-1]
    assert main(["dashboard", "--config", str(config), "--marks", "no/folder/m.jsonl"]) == 2
    assert "does not exist" in capsys.readouterr().err


@pytest.mark.slow
def test_on_a_bus_it_listens_serves_and_sends_nothing(config: Path) -> None:
    bus = open_port("udp_multicast", CHANNEL, fd=True, options={"port": PORT, "hop_limit": 0})
    process = subprocess.Popen(
        [sys.executable, "-m", "eps_hil.cli", "dashboard", "--config", str(config), "--port", "0"],
        stderr=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    try:
        assert process.stderr is not None
        said = process.stderr.readline()
        address = said.split()[1]
        assert address.startswith("http://127.0.0.1:")
        torques = FrameEncoder(load_database([ROOT / "dbc" / "eps_rig.dbc"]), "EPS_Torques")
        until_s, state = time.monotonic() + 240, ""
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect

        while (
            "EPS_MotorState (id 0x100)" not in state
            or "0x101" in state.rsplit("yet:", maxsplit=1)[-1]
        ):
            assert time.monotonic() < until_s, state
            bus.send(torques.frame({"MotorTorque": 0.1, "TorsionBarTorque": 0.2}))
            try:
                with connect(address.replace("http", "ws") + "feed", open_timeout=30) as page:
                    while not isinstance(text := page.recv(timeout=30), str) or "state" not in text:
                        pass
                state = "; ".join(json.loads(text)["state"]["problems"])
            except (OSError, TimeoutError, WebSocketException):
                time.sleep(0.2)
        with urllib.request.urlopen(address, timeout=60) as page_:
            assert b"dashboard.js" in page_.read()
        assert not bus.recv(0.2), "it sent a frame"
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        with pytest.raises(urllib.error.URLError):
            urllib.request.urlopen(address, timeout=5)
    finally:
        process.kill()
        bus.close()
