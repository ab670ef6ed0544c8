"""The last line: the session dies or stops in mid-injection, and the rig's torque goes to zero.

Real processes on a real bus: UDP multicast, and vcan0 of the kernel where there is one. What
counts is what the ECU puts on the bus: the torque it applies (``EPS_Torques``) after the last
command frame that it could hear.

``EPS_HIL_KILL_ON_VCAN=1`` adds vcan0 (docs/safety.md says how far that goes). User-Mode Linux has
one slow CPU and keeps no time: there the processes are forks of the test's own (nothing is loaded
twice), frames come every 5 ms, and the ECU's time-out is 0.2 s.
"""

import itertools
import json
import os
import re
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
from eps_hil.cli.main import main
from eps_hil.rig.ecu import OverrideState
from eps_hil.service import override_session
from eps_hil.service.config import load_config
from eps_hil.service.override_setup import prepare_override

from . import override_process
from .patience import PATIENT, slow_dbc

ROOT = Path(__file__).parents[2]
DATABASE = load_database([ROOT / "dbc" / "eps_rig.dbc"])
COMMAND, STATUS, STATE, TORQUES = 0x80, 0x130, 0x140, 0x101
PEAK_NM = 0.04
"""Below break-away, so that the rack stays where it is however long a test takes."""
ZERO_NM = 0.02
"""Noise of the reported torque is 4 mNm rms."""


@dataclass(frozen=True)
class Pace:
    """``cycle_s``: a late rig sends up to 20 ms of frames at once (its own limit), and the motor
    needs 3 ms itself; ``rate_hz``: of the ECU's reports."""

    timeout_s: float
    cycle_s: float
    rate_hz: int


UDP, VCAN = Pace(0.02, 0.02, 1000), Pace(0.2, 0.1, 200)
CHANNEL = "239.74.163.81"


class Fork:
    """A command as a fork of this process, with the face of ``subprocess.Popen``."""

    def __init__(self, command: list[str], said: Path) -> None:
        self._said = said
        self.returncode: int | None = None
        self.pid = os.fork()
        if self.pid == 0:
            os._exit(self._run(command))

    def _run(self, command: list[str]) -> int:
        """In the child: it must never go back into the test."""
        said = os.open(self._said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        os.dup2(said, 1)
        os.dup2(said, 2)
        sys.stdout = os.fdopen(1, "w", buffering=1)
        os.chdir(self._said.parent)
        try:
            if command[:2] == ["-m", "eps_hil.cli"]:
                return main(command[2:])
            return override_process.main(command[1:])
        except BaseException as error:
            print(repr(error))
            return 1

    def poll(self) -> int | None:
        if self.returncode is None:
            done, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if done else None
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def wait(self, timeout: float = 60.0) -> int | None:
        end = time.monotonic() + timeout
        while self.poll() is None:
            assert time.monotonic() < end, "it did not end"
            time.sleep(0.02)
        return self.returncode

    def communicate(self, timeout: float = 60.0) -> tuple[str, None]:
        self.wait(timeout)
        return self._said.read_text(), None


Started = subprocess.Popen[str] | Fork


def ended(process: Started) -> str:
    """Kill what still runs; what it said, or nothing where that was read before."""
    process.kill()
    read = isinstance(process, subprocess.Popen) and process.stdout and process.stdout.closed
    return "" if read else process.communicate()[0]


@dataclass
class Scene:
    """A rig and a session on one bus, and everything that was on it."""

    config: Path
    port: Port
    folder: Path
    pace: Pace
    frames: list[Frame] = field(default_factory=list)
    processes: list["Started"] = field(default_factory=list)

    def start(self, *command: str) -> "Started":
        if self.pace is VCAN:
            forked = Fork(list(command), self.folder / f"said{len(self.processes)}.txt")
            self.processes.append(forked)
            return forked
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
        said = [p.communicate()[0] for p in self.processes if p.poll() is not None]
        pytest.fail(f"no frame 0x{can_id:X} within {seconds} s; {said}")

    def injecting(self) -> "Started":
        """A session whose whole torque the ECU applies.

        Where the machine keeps no time (or is kept busy), a limit may end it before: again.
        """
        for _ in range(6):
            session = self.session()
            if self._until_injecting():
                return session
            said = ended(session)
        pytest.fail(f"the torque never came: {said}")

    def _until_injecting(self) -> bool:
        message = DATABASE.get_message_by_frame_id(TORQUES)
        end = time.monotonic() + 100.0
        while time.monotonic() < end:
            self.listen(0.1)
            last = [message.decode(f.data)["MotorTorque"] for f in self.of(TORQUES)[-20:]]
            if last and min(last) > PEAK_NM - ZERO_NM:
                return True
            if self.processes[-1].poll() is not None:
                break
        return False

    def reports(self, seconds: float) -> list[float]:
        """Torque that the ECU reported in the last seconds."""
        return self.applied()[-round(seconds * self.pace.rate_hz) :]

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

    def hit(self, number: signal.Signals, listen_s: float) -> "Started":
        """A session that is sent a signal in mid-injection, and what was on the bus after it.

        A machine that stood still just then has measured itself: again.
        """
        for _ in range(5):
            session = self.injecting()
            session.send_signal(number)
            self.listen(listen_s)
            if self.kept_time():
                return session
            ended(session)
            self.forget()
        pytest.fail("this machine stands still again and again")

    def kept_time(self) -> bool:
        """Whether the ECU's reports came without a hole around the last enabling command."""
        last_ns = self.enabled()[-1].t_ns
        stamps = [frame.t_ns for frame in self.of(TORQUES)]
        near = [t_ns for t_ns in stamps if -50e6 < t_ns - last_ns < 250e6]
        holes = [b - a for a, b in itertools.pairwise(near)]
        return max(holes) < 8e9 / self.pace.rate_hz

    def forget(self) -> None:
        """Everything heard and written so far."""
        self.listen(0.1)
        self.frames.clear()
        (self.folder / "journal.jsonl").unlink(missing_ok=True)

    def session(self) -> "Started":
        script = str(Path(__file__).with_name("override_process.py"))
        return self.start(script, str(self.config), "journal.jsonl", str(PEAK_NM))

    def journal(self) -> list[dict[str, object]]:
        text = (self.folder / "journal.jsonl").read_text()
        return [json.loads(line) for line in text.splitlines()]


def slower(folder: Path) -> str:
    """A configuration for a machine that is slow and keeps no time; its DBC beside it."""
    text = config_text("{interface: socketcan, channel: vcan0}")
    text = text.replace(f"{ROOT}/dbc/eps_rig.dbc", slow_dbc(folder).name)
    for name, value in PATIENT.items():
        text = re.sub(rf"(\b{name}:) \S+", rf"\1 {json.dumps(value)}", text)
    text = text.replace(
        "loop: true}", f"loop: true, realtime: false, override_timeout_s: {VCAN.timeout_s}}}"
    )
    return (
        text + "service: {realtime: off, no_input_after_s: 0.1}\nestimator: {stale_after_s: 0.1}\n"
    )


def config_text(bus: str) -> str:
    text = (ROOT / "configs" / "calibrate_udp.yaml").read_text()
    head = text.index("bus:")
    text = text[text.index("dbc:", head) :]
    text = text.replace("../dbc", f"{ROOT}/dbc").replace("signals: ", f"signals: {ROOT}/configs/")
    return f"bus: {bus}\n" + text.replace("model: ", f"model: {ROOT}/configs/")


ON_VCAN = [pytest.param("vcan0", marks=pytest.mark.socketcan)]


@pytest.fixture(
    scope="module", params=["udp", *(ON_VCAN if "EPS_HIL_KILL_ON_VCAN" in os.environ else [])]
)
def stage(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> Iterator[Scene]:
    """One rig for all tests: each session finds the ECU as the one before left it."""
    tmp_path = tmp_path_factory.mktemp("override")
    config = tmp_path / "c.yaml"
    if request.param == "vcan0":
        request.getfixturevalue("vcan0")
        config.write_text(slower(tmp_path))
        prepare_override(load_config(config), config).estimator.warm_up()  # for all forks
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(override_session, "_LATE_NS", 50_000_000)
            yield from _staged(config, open_port("socketcan", "vcan0", send_ids=()), VCAN)
        return
    number = 44_000 + hash(str(tmp_path)) % 10_000
    options = {"port": number, "hop_limit": 0}
    bus = f"{{interface: udp_multicast, channel: {CHANNEL}, fd: true, options: {options}}}"
    port = open_port("udp_multicast", CHANNEL, fd=True, send_ids=(), options=options)
    config.write_text(config_text(bus.replace("'", "")))
    yield from _staged(config, port, UDP)


def _staged(config: Path, port: Port, pace: Pace) -> Iterator[Scene]:
    made = Scene(config, port, config.parent, pace)
    try:
        made.start("-m", "eps_hil.cli", "rig", "--config", str(config))
        made.until(TORQUES, 200.0)
        yield made
    finally:
        for process in made.processes:
            ended(process)
        port.close()


@pytest.fixture
def scene(stage: Scene) -> Iterator[Scene]:
    """An empty stage with the rig on it; no session outlives its test."""
    yield stage
    for process in stage.processes[1:]:
        ended(process)
    del stage.processes[1:]
    stage.forget()


@pytest.mark.slow
def test_sigkill_in_mid_injection(scene: Scene) -> None:
    scene.hit(signal.SIGKILL, 0.5).wait()
    assert scene.zero_after_s() < scene.pace.timeout_s + scene.pace.cycle_s
    assert max(map(abs, scene.reports(0.2))) < ZERO_NM, "and it stays at zero"
    assert scene.signals(STATUS, "OverrideState")[-1] == OverrideState.TIMED_OUT
    told = [(line["from"], line["to"]) for line in scene.journal()]
    assert told[-1] == ("armed", "injecting"), "the journal holds all up to the kill"


@pytest.mark.slow
def test_sigstop_in_mid_injection_and_nothing_resumes_after_sigcont(scene: Scene) -> None:
    session = scene.hit(signal.SIGSTOP, 0.6)
    assert scene.zero_after_s() < scene.pace.timeout_s + scene.pace.cycle_s
    enabled = len(scene.enabled())
    session.send_signal(signal.SIGCONT)
    scene.listen(1.0)
    # A frame may have been on its way into the kernel when the stop came; the ECU's latched
    # time-out is there for it.
    assert len(scene.enabled()) <= enabled + 1
    assert max(map(abs, scene.reports(0.9))) < ZERO_NM
    out, _ = session.communicate(timeout=20)
    assert session.returncode == 3, out
    assert re.search("injecting -> fault: .*(clock|stale input)", out), out
    last = scene.journal()[-2]
    assert last["to"] == "fault"
    assert "clock" in str(last["trips"])


@pytest.mark.slow
def test_sigterm_releases_at_once(scene: Scene) -> None:
    session = scene.hit(signal.SIGTERM, 0.5)
    out, _ = session.communicate(timeout=20)
    assert session.returncode == 3, out
    assert scene.zero_after_s() < scene.pace.cycle_s + 0.005, (
        "the release is faster than the time-out"
    )
    assert scene.signals(STATUS, "OverrideState")[-1] == OverrideState.RELEASED
    assert scene.signals(STATE, "State")[-1] == 0, "the last word on the bus: off"
    assert [line["to"] for line in scene.journal()][-2:] == ["fault", "off"]
    assert scene.journal()[-2]["why"] == "operator: SIGTERM"
