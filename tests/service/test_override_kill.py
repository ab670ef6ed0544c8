"""The last line: the session dies or stops in mid-injection, and the rig's torque goes to zero.

Real processes on a real bus. What counts is what the ECU puts on the bus: the torque it applies
(``EPS_Torques``) after the last command frame that it could hear.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port, open_port
from eps_hil.rig.ecu import OverrideState

ROOT = Path(__file__).parents[2]
DATABASE = load_database([ROOT / "dbc" / "eps_rig.dbc"])
COMMAND, STATUS, STATE, TORQUES = 0x80, 0x130, 0x140, 0x101
PEAK_NM = 0.04
"""Below break-away, so that the rack stays where it is however long a test takes."""
ZERO_NM = 0.02
"""Noise of the reported torque is 4 mNm rms."""
CYCLE_S = 0.02
"""A late rig sends up to 20 ms of frames at once (its own limit); the motor needs 3 ms itself."""
TIMEOUT_S = 0.02
CHANNEL = "239.74.163.81"


@dataclass
class Scene:
    """A rig and a session on one bus, and everything that was on it."""

    config: Path
    port: Port
    folder: Path
    frames: list[Frame] = field(default_factory=list)
    processes: list["subprocess.Popen[str]"] = field(default_factory=list)

    def start(self, *command: str) -> "subprocess.Popen[str]":
        process = subprocess.Popen(
            [sys.executable, *command],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=self.folder,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )
        self.processes.append(process)
        return process

    def listen(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self.frames += self.port.recv(min(left, 0.05))

    def until(self, can_id: int, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            fresh = self.port.recv(0.1)
            self.frames += fresh
            if any(frame.can_id == can_id for frame in fresh):
                return
        said = [p.stdout.read() for p in self.processes if p.poll() is not None and p.stdout]
        pytest.fail(f"no frame 0x{can_id:X} within {seconds} s; {said}")

    def until_injecting(self) -> None:
        """Until the ECU applies the whole torque."""
        message = DATABASE.get_message_by_frame_id(TORQUES)
        end = time.monotonic() + 100.0
        while time.monotonic() < end:
            self.listen(0.1)
            last = [message.decode(f.data)["MotorTorque"] for f in self.of(TORQUES)[-20:]]
            if last and min(last) > PEAK_NM - ZERO_NM:
                return
            if self.processes[-1].poll() is not None:
                break
        self.processes[-1].kill()
        pytest.fail(f"the torque never came: {self.processes[-1].communicate()[0]}")

    def of(self, can_id: int) -> list[Frame]:
        return [frame for frame in self.frames if frame.can_id == can_id and not frame.error]

    def signals(self, can_id: int, signal_name: str) -> list[float]:
        message = DATABASE.get_message_by_frame_id(can_id)
        return [
            float(message.decode(f.data, decode_choices=False)[signal_name])
            for f in self.of(can_id)
        ]

    def applied(self) -> list[float]:
        return self.signals(TORQUES, "MotorTorque")

    def enabled(self) -> list[Frame]:
        message = DATABASE.get_message_by_frame_id(COMMAND)
        return [
            f
            for f in self.of(COMMAND)
            if message.decode(f.data, decode_choices=False)["OverrideRequest"] == 1
        ]

    def zero_after_s(self) -> float:
        """From the last enabling command to the last report of more than noise."""
        last_ns = self.enabled()[-1].t_ns
        loud = [
            frame.t_ns
            for frame, nm in zip(self.of(TORQUES), self.applied(), strict=True)
            if abs(nm) > ZERO_NM
        ]
        return (loud[-1] - last_ns) * 1e-9

    def session(self) -> "subprocess.Popen[str]":
        script = str(Path(__file__).with_name("override_process.py"))
        return self.start(script, str(self.config), "journal.jsonl", str(PEAK_NM))

    def journal(self) -> list[dict[str, object]]:
        text = (self.folder / "journal.jsonl").read_text()
        return [json.loads(line) for line in text.splitlines()]


def config_text(bus: str) -> str:
    text = (ROOT / "configs" / "calibrate_udp.yaml").read_text()
    head = text.index("bus:")
    text = text[text.index("dbc:", head) :]
    text = text.replace("../dbc", f"{ROOT}/dbc").replace("signals: ", f"signals: {ROOT}/configs/")
    return f"bus: {bus}\n" + text.replace("model: ", f"model: {ROOT}/configs/")


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scene]:
    """One rig for all tests: each session finds the ECU as the one before left it."""
    tmp_path = tmp_path_factory.mktemp("override")
    number = 44_000 + hash(str(tmp_path)) % 10_000
    options = {"port": number, "hop_limit": 0}
    bus = f"{{interface: udp_multicast, channel: {CHANNEL}, fd: true, options: {options}}}"
    port = open_port("udp_multicast", CHANNEL, fd=True, send_ids=(), options=options)
    config = tmp_path / "c.yaml"
    config.write_text(config_text(bus.replace("'", "")))
    made = Scene(config, port, tmp_path)
    try:
        made.start("-m", "eps_hil.cli", "rig", "--config", str(config))
        made.until(TORQUES, 200.0)
        yield made
    finally:
        for process in made.processes:
            process.kill()
            process.communicate()
        port.close()


@pytest.fixture
def scene(stage: Scene) -> Iterator[Scene]:
    """An empty stage with the rig on it; no session outlives its test."""
    yield stage
    for process in stage.processes[1:]:
        process.kill()
        process.communicate()
    del stage.processes[1:]
    stage.listen(0.1)
    stage.frames.clear()
    (stage.folder / "journal.jsonl").unlink(missing_ok=True)


@pytest.mark.slow
def test_sigkill_in_mid_injection(scene: Scene) -> None:
    session = scene.session()
    scene.until_injecting()
    session.send_signal(signal.SIGKILL)
    session.wait()
    scene.listen(0.5)
    assert scene.zero_after_s() < TIMEOUT_S + CYCLE_S
    assert max(map(abs, scene.applied()[-200:])) < ZERO_NM, "and it stays at zero"
    assert scene.signals(STATUS, "OverrideState")[-1] == OverrideState.TIMED_OUT
    told = [(line["from"], line["to"]) for line in scene.journal()]
    assert told[-1] == ("armed", "injecting"), "the journal holds all up to the kill"


@pytest.mark.slow
def test_sigstop_in_mid_injection_and_nothing_resumes_after_sigcont(scene: Scene) -> None:
    session = scene.session()
    scene.until_injecting()
    session.send_signal(signal.SIGSTOP)
    scene.listen(0.6)
    assert scene.zero_after_s() < TIMEOUT_S + CYCLE_S
    enabled = len(scene.enabled())
    session.send_signal(signal.SIGCONT)
    scene.listen(1.0)
    # A frame may have been on its way into the kernel when the stop came; the ECU's latched
    # time-out is there for it.
    assert len(scene.enabled()) <= enabled + 1
    assert max(map(abs, scene.applied()[-900:])) < ZERO_NM
    out, _ = session.communicate(timeout=20)
    assert session.returncode == 3, out
    assert "injecting -> fault: clock" in out or "stale input" in out
    last = scene.journal()[-2]
    assert last["to"] == "fault"
    assert "clock" in str(last["trips"])


@pytest.mark.slow
def test_sigterm_releases_at_once(scene: Scene) -> None:
    session = scene.session()
    scene.until_injecting()
    session.send_signal(signal.SIGTERM)
    out, _ = session.communicate(timeout=20)
    scene.listen(0.2)
    assert session.returncode == 3, out
    assert scene.zero_after_s() < CYCLE_S + 0.005, "the release is faster than the time-out"
    assert scene.signals(STATUS, "OverrideState")[-1] == OverrideState.RELEASED
    assert scene.signals(STATE, "State")[-1] == 0, "the last word on the bus: off"
    assert [line["to"] for line in scene.journal()][-2:] == ["fault", "off"]
    assert scene.journal()[-2]["why"] == "operator: SIGTERM"
