"""``eps-hil run`` as a user meets it: a process on a bus, signals, exit status, one-line errors."""

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import open_port
from eps_hil.cli.main import main

ROOT = Path(__file__).parents[2]
DATABASE = load_database([ROOT / "dbc" / "eps_rig.dbc"])
CHANNEL = "239.74.163.78"
OPTIONS = {"port": 43178, "hop_limit": 0}
CONFIG = f"""bus: {{interface: udp_multicast, channel: {CHANNEL}, fd: true,
      options: {{port: 43178, hop_limit: 0}}}}
dbc: {ROOT}/dbc/eps_rig.dbc
signals: {ROOT}/configs/eps_rig_signals.yaml
model: {ROOT}/configs/reference_rig.yaml
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "c.yaml"
    path.write_text(CONFIG)
    return path


def sliding(t_s: float) -> dict[str, float]:
    """Signals of a rotor that goes to and fro by 16 rad in 10 s; the load cell reads 500 N."""
    rate = 2.0 * math.pi / 10.0
    angle = 16.0 * math.sin(rate * t_s)
    return {
        "MotorTorque": 0.2 + 0.02 * math.sin(rate * t_s),
        "TorsionBarTorque": 0.3 * math.sin(rate * t_s),
        "RackForce": 500.0,
        "MotorSpeed": 16.0 * rate * math.cos(rate * t_s),
        "MotorAngle": angle,
        "RackPosition": angle / 2513.0,
    }


class Feed(threading.Thread):
    """A rotor that slides to and fro under some torque, until stopped; keeps what is sent.

    At rest nothing would be valid: the friction is unknown before it has slid.
    """

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[Frame] = []
        self._stopped = threading.Event()

    def run(self) -> None:
        names = ("EPS_Torques", "RIG_State", "EPS_MotorState")
        encoders = [FrameEncoder(DATABASE, name) for name in names]
        port = open_port("udp_multicast", CHANNEL, fd=True, options=OPTIONS)
        start = time.monotonic()
        for k in range(60_000):
            for encoder in encoders:
                port.send(encoder.frame(sliding(k * 1e-3)))
            self.seen += port.recv(0.0)
            time.sleep(max(0.0, start + k * 1e-3 - time.monotonic()))
            if self._stopped.is_set():
                break
        end = time.monotonic() + 0.2
        while time.monotonic() < end:
            self.seen += port.recv(0.05)
        port.close()

    def stop(self) -> None:
        self._stopped.set()
        self.join()


@contextmanager
def feeding() -> Iterator[Feed]:
    feed = Feed()
    feed.start()
    try:
        yield feed
    finally:
        feed.stop()


STARTED: list[subprocess.Popen[str]] = []


@pytest.fixture(autouse=True)
def nothing_left_running() -> Iterator[None]:
    """A service that outlives its failed test would be the next one's second transmitter."""
    yield
    while STARTED:
        process = STARTED.pop()
        if process.poll() is None:
            process.kill()
            process.wait()


def start(config: Path, *options: str) -> subprocess.Popen[str]:
    # what ``nohup`` (of whoever runs the tests) would make children inherit
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    process = subprocess.Popen(
        [sys.executable, "-m", "eps_hil.cli", "run", "--config", str(config), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    STARTED.append(process)
    return process


def wait_ready(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    said = ""
    for line in process.stdout:
        said += line
        if line == "READY\n":
            return said
    raise AssertionError(f"ended before READY: {said} {process.communicate()[1]}")


_ALSO = [pytest.param(each, marks=pytest.mark.slow) for each in (signal.SIGINT, signal.SIGHUP)]


@pytest.mark.parametrize("number", [signal.SIGTERM, *_ALSO])
def test_runs_until_a_signal_and_stops_cleanly(config: Path, number: signal.Signals) -> None:
    with feeding() as feed:
        process = start(config)
        said = wait_ready(process)
        time.sleep(0.8)
        process.send_signal(number)
        out, err = process.communicate(timeout=10)
    assert process.returncode == 0
    assert err == ""  # no live line in a pipe
    assert "listen     0x100 EPS_MotorState" in said
    assert "send       0x120 EPSHIL_Estimate" in said
    assert out.startswith("steps ")
    assert "lateness   p50" in out
    estimates = [f for f in feed.seen if f.can_id == 0x120]
    assert len(estimates) > 300
    told = [DATABASE.decode_message(0x120, f.data, decode_choices=False) for f in estimates]
    assert 2 in [each["EstimateStatus"] for each in told]
    assert told[-1]["EstimateStatus"] == 0
    assert {f.can_id for f in feed.seen} == {0x120, 0x121, 0x400}


@pytest.mark.slow
def test_duration_log_and_a_live_line_on_request(config: Path, tmp_path: Path) -> None:
    log = tmp_path / "e.csv"
    with feeding():
        process = start(config, "--duration", "0.6", "--status-line", "--log-estimates", str(log))
        out, err = process.communicate(timeout=30)
    assert process.returncode == 0
    assert "steps " in out
    assert "rack force" in err
    assert "load cell     +500 N" in err
    assert len(log.read_text().splitlines()) > 400


@pytest.mark.slow
def test_the_operator_gives_friction_levels_to_the_running_service(
    config: Path, tmp_path: Path
) -> None:
    model, journal = tmp_path / "model.yaml", tmp_path / "journal.jsonl"
    good = (ROOT / "configs" / "reference_rig.yaml").read_text()
    model.write_text(good)
    text = config.read_text().replace(f"{ROOT}/configs/reference_rig.yaml", str(model))
    config.write_text(text + "adaptation: {}\n")
    files = (good.replace("5.600e-2", "6.5e-2"), "model: [", good.replace("1.258e-1", "1.258"))
    with feeding() as feed:
        process = start(config, "--journal", str(journal))
        said = wait_ready(process)
        time.sleep(0.4)
        for content in files:
            model.write_text(content)
            process.send_signal(signal.SIGUSR1)
            time.sleep(0.6)
        process.terminate()
        out, err = process.communicate(timeout=10)
    assert process.returncode == 0, err
    assert f"kill -USR1 {process.pid}" in said
    assert "adapt      levels only on the operator's word" in said
    assert "levels     operator k0+ 0.0650, k0- 0.1258 Nm taken\n" in out
    assert "levels     not taken: " in out
    assert "not valid YAML" in out
    assert "Nm refused: more than 50% from the accepted 0.0650, 0.1258 Nm" in out
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    assert [line["levels"] for line in lines] == ["taken", "refused"]
    told = [DATABASE.decode_message(0x150, f.data) for f in feed.seen if f.can_id == 0x150]
    assert str(told[0]["LevelSource"]) == "model"
    assert str(told[-1]["LevelSource"]) == "operator"
    # on its way at 5 mNm/s
    assert 0.056 < float(told[-1]["LevelPositive"]) <= 0.065


def test_a_journal_that_cannot_be_written_is_status_2(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config.write_text(config.read_text() + "adaptation: {}\n")
    assert main(["run", "--config", str(config), "--journal", "/no/such/j.jsonl"]) == 2
    assert "/no/such/j.jsonl: cannot be written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ("{method: magic}", "adaptation.method"),
        ("{sanity_band: 3}", "adaptation.sanity_band"),
        ("{apply: always}", "adaptation.apply"),
        ("{reversals: {strech_s: 3}}", "adaptation.reversals.strech_s: is not a known field"),
    ],
)
def test_a_mistake_in_the_adaptation_block(
    config: Path, capsys: pytest.CaptureFixture[str], block: str, said: str
) -> None:
    config.write_text(config.read_text() + f"adaptation: {block}\n")
    assert main(["run", "--config", str(config)]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1


@pytest.mark.slow
def test_the_second_service_on_a_bus_is_refused(config: Path) -> None:
    with feeding():
        first = start(config)
        wait_ready(first)
        second = start(config)
        _, err = second.communicate(timeout=30)
        first.terminate()
        out, _ = first.communicate(timeout=10)
    assert second.returncode == 1
    assert err.startswith("eps-hil: udp_multicast")
    assert "another transmitter sends our ids" in err
    assert err.count("\n") == 1
    assert first.returncode == 0
    assert "somebody else" not in out


def test_killed_it_goes_silent(config: Path) -> None:
    with feeding() as feed:
        process = start(config)
        wait_ready(process)
        time.sleep(0.3)
        process.kill()
        process.communicate()
        time.sleep(0.1)
        before = len(feed.seen)
        time.sleep(0.3)
        after = len(feed.seen)
    assert before > 100
    assert after == before


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("eps_rig.dbc", "eps_rog.dbc", "no such file"),
        ("signals:", "signal:", "signal: is not a known field"),
        ("fd: true", "fd: maybe", "line 1: bus.fd"),
        (CONFIG, CONFIG + "publish: {message: None_Such}\n", "has no message None_Such"),
        (CONFIG, "bus: [\n", "not valid YAML"),
    ],
)
def test_bad_configuration_is_status_2_and_one_line(
    config: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    config.write_text(config.read_text().replace(old, new))
    assert main(["run", "--config", str(config)]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert str(config) in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("arguments", [["run"], ["run", "--config", "no_such.yaml"]])
def test_without_a_configuration(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_bus_that_is_not_there_is_status_1_and_one_line(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = config.read_text().replace("udp_multicast", "socketcan").replace(CHANNEL, "can77")
    config.write_text(text.replace("options: {port: 43178, hop_limit: 0}", "options: {}"))
    assert main(["run", "--config", str(config)]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_an_unwritable_log_is_status_2(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--config", str(config), "--log-estimates", "/no/such/e.csv"]) == 2
    assert "/no/such/e.csv" in capsys.readouterr().err


def test_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--schema"]) == 0
    assert "publish" in json.loads(capsys.readouterr().out)["properties"]
