"""``eps-hil monitor`` as a user meets it: a process beside rig and service on UDP multicast."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from eps_hil.bus.config import BusConfig
from eps_hil.bus.port import open_port
from eps_hil.cli.main import main
from eps_hil.errors import BusError
from eps_hil.monitor.process import listen_only, open_watched

ROOT = Path(__file__).parents[2]
CHANNEL, PORT = "239.74.163.93", 43193
CONFIG = f"""bus: {{interface: udp_multicast, channel: {CHANNEL}, fd: true,
      options: {{port: {PORT}, hop_limit: 0}}}}
dbc: {ROOT}/dbc/eps_rig.dbc
signals: {ROOT}/configs/eps_rig_signals.yaml
model: {ROOT}/configs/reference_rig.yaml
rig: {{manoeuvre: weave, loop: true}}
"""
STARTED: list[subprocess.Popen[str]] = []


@pytest.fixture(autouse=True)
def nothing_left_running() -> Iterator[None]:
    yield
    while STARTED:
        process = STARTED.pop()
        if process.poll() is None:
            process.kill()
            process.wait()


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "c.yaml"
    path.write_text(CONFIG)
    return path


def start(verb: str, config: Path, *options: str) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-m", "eps_hil.cli", verb, "--config", str(config), *options],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    STARTED.append(process)
    return process


def wait_for(process: subprocess.Popen[str], word: str) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if word in line:
            return
    raise AssertionError(f"ended before '{word}': {process.communicate()[1]}")


@pytest.mark.slow
def test_beside_rig_and_service_json_and_an_alarm_that_ends_it(
    config: Path, tmp_path: Path
) -> None:
    """The rig obeys the reference model; the configuration's model has 40 mNm less friction."""
    model, journal = tmp_path / "model.yaml", tmp_path / "alarms.jsonl"
    good = (ROOT / "configs" / "reference_rig.yaml").read_text()
    good = good.replace("offset_pos_nm: 5.600e-2", "offset_pos_nm: 0.016")
    model.write_text(good.replace("offset_neg_nm: 1.258e-1", "offset_neg_nm: 0.0858"))
    text = config.read_text()
    reference = f"{ROOT}/configs/reference_rig.yaml"
    text = text.replace(reference, str(model)).replace("weave,", f"weave, model: {reference},")
    config.write_text(text)
    rig = start("rig", config)
    wait_for(rig, "timing")
    service = start("run", config)
    wait_for(service, "READY")
    watching = start(
        "monitor", config, "--json", "--alarm-after", "2", "--alarm-exit", "--bell",
        "--journal", str(journal), "--seconds", "60",
    )  # fmt: skip
    out, err = watching.communicate(timeout=120)
    assert watching.returncode == 1, err
    assert "rig and model part" in err
    assert "\a" in err
    seen = [json.loads(line) for line in out.splitlines()]
    assert {each["schema"] for each in seen} == {"eps-hil/monitor/1"}
    assert seen[-1]["parted"]
    assert not seen[0]["parted"]
    balances = [b for each in seen if (b := each["residual"]["balance_nm"]) is not None]
    assert balances[-1] == pytest.approx(0.04, rel=0.25)
    assert "EPSHIL_Health" in seen[-1]["told"]
    noted = [json.loads(line) for line in journal.read_text().splitlines()]
    assert noted[0]["on"] is True
    assert noted[0]["rms_n"] > noted[0]["limit_n"]
    service.terminate()
    assert "somebody else" not in service.communicate(timeout=20)[0]  # nothing else was sent


@pytest.mark.slow
def test_once_on_a_silent_bus_is_status_1(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", "--config", str(config), "--once", "--seconds", "0.3"]) == 1
    said = capsys.readouterr()
    assert "never seen" in said.out
    assert said.err.splitlines()[-1].endswith("no frame came; is the rig on this bus?")


def test_its_port_cannot_send() -> None:
    from eps_hil.bus.frame import Frame

    bus = BusConfig("udp_multicast", CHANNEL, True, {"port": PORT, "hop_limit": 0})
    for port in (listen_only(bus), open_watched(bus, lambda _: None)):
        with pytest.raises(BusError, match="not configured to send"):
            port.send(Frame(0, 0x120, bytes(8)))
        port.close()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (CONFIG.replace("eps_rig.dbc", "eps_rog.dbc"), "no such file"),
        ("bus: [\n", "not valid YAML"),
        (CONFIG.replace(CHANNEL, "10.0.0.1"), "not a multicast address"),
    ],
)
def test_a_wrong_configuration_is_one_line(
    config: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    config.write_text(text)
    assert main(["monitor", "--config", str(config), "--once"]) in {1, 2}
    err = capsys.readouterr().err.removeprefix("monitor: loading\n")
    assert said in err
    assert err.count("\n") == 1


def test_a_night_without_a_load_cell_is_refused(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing could end it."""
    mapping = ROOT / "configs" / "eps_rig_signals.yaml"
    without = yaml.safe_load(mapping.read_text())
    del without["signals"]["rack_force_n"]
    (tmp_path / "signals.yaml").write_text(yaml.safe_dump(without))
    config.write_text(config.read_text().replace(str(mapping), str(tmp_path / "signals.yaml")))
    assert main(["monitor", "--config", str(config), "--alarm-exit"]) == 2
    said = capsys.readouterr().err
    assert "signals.yaml: signals: rack_force_n is not mapped" in said
    assert said.count("\n") == 1


@pytest.mark.slow
def test_lines_in_a_pipe_end_by_themselves(config: Path) -> None:
    sender = open_port("udp_multicast", CHANNEL, fd=True, options={"port": PORT, "hop_limit": 0})
    watching = start("monitor", config, "--seconds", "2.5")
    time.sleep(0.5)
    out, err = watching.communicate(timeout=120)
    sender.close()
    assert watching.returncode == 0, err
    assert out.splitlines()[-1].startswith("estimate – N silent (no frame yet)")
    assert "never seen: motor_torque_nm" in out
