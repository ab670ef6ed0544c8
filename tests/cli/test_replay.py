"""``eps-hil replay`` as a person meets it: no command of a log reaches a bus, whatever is asked."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port, open_port
from eps_hil.cli._replay_commands import _say_done
from eps_hil.cli.main import main
from eps_hil.errors import EpsHilError, InputError

ROOT = Path(__file__).parents[2]
GROUP = "239.74.163.83"
DATABASE = load_database([ROOT / "dbc" / "eps_rig.dbc"])


def candump(frames: list[Frame]) -> str:
    lines = [
        f"({f.t_ns * 1e-9:.6f}) can0 {f.can_id:0{8 if f.extended else 3}X}#{f.data.hex().upper()}\n"
        for f in frames
    ]
    return "".join(lines)


def calibration_log() -> list[Frame]:
    """100 ms of a torque injection: reports, Enable frames, a set-point, both id formats."""
    torque = FrameEncoder(DATABASE, "EPSHIL_TorqueOverride")
    rig = FrameEncoder(DATABASE, "RIG_Command")
    state = FrameEncoder(DATABASE, "EPS_MotorState")
    frames = []
    for k in range(100):
        t_ns = 1_790_000_000_000_000_000 + k * 1_000_000
        enabled = torque.frame({"RequestedMotorTorque": 0.1, "OverrideRequest": 1})
        command = rig.frame({"WheelSpeedSetPoint": 1.0, "CommandRequest": 1})
        for one in (
            state.frame({"MotorSpeed": 1.0, "MotorAngle": 0.0}),
            enabled,
            replace(enabled, extended=True),
            command,
        ):
            frames.append(replace(one, t_ns=t_ns))
    return frames


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "calibration.log"
    path.write_text(candump(calibration_log()))
    return path


class Ear(threading.Thread):
    """Everything that is on the bus."""

    def __init__(self, port: Port) -> None:
        super().__init__()
        self.port, self.frames = port, list[Frame]()
        self._stopped = threading.Event()
        self.start()

    def run(self) -> None:
        while not self._stopped.is_set():
            self.frames += self.port.recv(0.02)

    def stop(self) -> list[Frame]:
        time.sleep(0.1)
        self._stopped.set()
        self.join()
        return self.frames


@pytest.fixture
def udp_port(tmp_path: Path) -> int:
    return 44_000 + hash(str(tmp_path)) % 10_000


@pytest.fixture
def ear(udp_port: int) -> Iterator[Ear]:
    options = {"port": udp_port, "hop_limit": 0}
    made = Ear(open_port("udp_multicast", GROUP, options=options))
    yield made
    made.stop()
    made.port.close()


def bus_options(udp_port: int) -> list[str]:
    return ["--interface", "udp_multicast", "--channel", GROUP, "--option", f"port={udp_port}"]


def config_file(folder: Path, udp_port: int, *, override: bool) -> Path:
    text = (ROOT / "configs" / "calibrate_udp.yaml").read_text()
    text = text[text.index("dbc:") :].replace("../dbc", f"{ROOT}/dbc")
    text = text.replace("signals: ", f"signals: {ROOT}/configs/")
    text = text.replace("model: ", f"model: {ROOT}/configs/")
    if not override:
        text = text[: text.index("override:")]
    options = f"{{port: {udp_port}, hop_limit: 0}}"
    bus = f"{{interface: udp_multicast, channel: {GROUP}, fd: true, options: {options}}}"
    path = folder / "c.yaml"
    path.write_text(f"bus: {bus}\n{text}")
    return path


def replay(*words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "eps_hil.cli", "replay", *words],
        capture_output=True, text=True, timeout=250, stdin=subprocess.DEVNULL, check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    "where",
    [
        pytest.param("options", marks=pytest.mark.slow),
        "config without override",
        pytest.param("config with override", marks=pytest.mark.slow),
    ],
)
def test_a_calibration_log_commands_nothing(
    where: str, log: Path, ear: Ear, udp_port: int, tmp_path: Path
) -> None:
    words = bus_options(udp_port)
    if where != "options":
        words = ["--config", str(config_file(tmp_path, udp_port, override="without" not in where))]
    told = replay(str(log), *words)
    assert told.returncode == 0, told.stderr
    assert {frame.can_id for frame in ear.stop()} == {0x100}
    said = "0x80 EPSHIL_TorqueOverride (commands a torque) 200 x, 0xA0 RIG_Command"
    assert f"commands are left out: {said}" in told.stderr
    assert f"commands left out: {said}" in told.stdout
    assert "sent 100 frames" in told.stdout


@pytest.mark.parametrize("asked", ["0x80", "128,0x100", "160"])
def test_asking_for_the_id_does_not_get_round_it(
    asked: str, log: Path, ear: Ear, udp_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(log), *bus_options(udp_port), "--ids", asked]) == 2
    said = capsys.readouterr().err
    assert re.search(r"--ids: 0x(80|A0) .*is never replayed as a frame", said)
    assert said.count("\n") == 1
    assert ear.stop() == []


def test_a_command_under_another_id_stays_out_by_its_database(
    log: Path, ear: Ear, udp_port: int, tmp_path: Path
) -> None:
    """The bench of somebody who moved the override to a 29-bit id."""
    text = (ROOT / "dbc" / "eps_rig.dbc").read_text()
    moved = 0x18FF0080
    for old, new in ((128, moved | 0x8000_0000), (160, 0x2A0)):
        text = re.sub(rf"\b(BO_|SG_|VAL_) {old}\b", rf"\g<1> {new}", text)
    dbc = tmp_path / "moved.dbc"
    dbc.write_text(text)
    frames = [
        replace(f, can_id=moved if f.extended else 0x2A0) if f.can_id == 0x80 else f
        for f in calibration_log()
    ]
    log.write_text(candump(frames))
    told = replay(str(log), *bus_options(udp_port), "--dbc", str(dbc))
    assert told.returncode == 0, told.stderr
    assert {frame.can_id for frame in ear.stop()} == {0x100}
    assert "0x18FF0080 EPSHIL_TorqueOverride" in told.stdout


def bench_config(folder: Path, udp_port: int) -> Path:
    """Of a bench whose torque command is ECU_Cmd, 0x90, by the override block alone."""
    text = (ROOT / "dbc" / "eps_rig.dbc").read_text().replace("EPSHIL_TorqueOverride", "ECU_Cmd")
    (folder / "bench.dbc").write_text(re.sub(r"\b(BO_|SG_|VAL_) 128\b", r"\1 144", text))
    config = config_file(folder, udp_port, override=True)
    said = config.read_text().replace(f"{ROOT}/dbc/eps_rig.dbc", "bench.dbc")
    config.write_text(said.replace("override:\n", "override:\n  command_message: ECU_Cmd\n", 1))
    return config


VEHICLE = """VERSION ""
BU_: A
BO_ 1500 Vehicle: 8 A
 SG_ Speed : 0|8@1+ (1,0) [0|255] "" A
"""


def test_a_database_beside_the_configuration_adds_to_what_stays_out(
    log: Path, ear: Ear, udp_port: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With --dbc the torques of the bench's command went out as they stood in the log."""
    log.write_text(candump([replace(f, can_id=0x90) for f in ramp_log()[:50]]))
    config = bench_config(tmp_path, udp_port)
    dbc = tmp_path / "vehicle.dbc"
    dbc.write_text(VEHICLE)
    words = [str(log), "--config", str(config), "--dbc", str(dbc)]
    assert main(["replay", *words]) == 0
    assert "commands left out: 0x90 ECU_Cmd (commands a torque) 50 x" in capsys.readouterr().out
    assert ear.stop() == []
    config.write_text(f"override: {{command_message: ECU_Cmd}}\nbus: {BUS.format(udp_port)}")
    assert main(["replay", *words]) == 2
    said = "override.command_message: no database has a message ECU_Cmd"
    assert said in capsys.readouterr().err


BUS = "{{interface: udp_multicast, channel: 239.74.163.2, options: {{port: {}, hop_limit: 0}}}}"


def test_it_does_not_talk_over_a_live_sender(
    log: Path, ear: Ear, udp_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    stopped = threading.Event()

    def talk() -> None:
        while not stopped.wait(0.05):
            ear.port.send(Frame(0, 0x100, bytes(8)))

    talker = threading.Thread(target=talk)
    talker.start()
    try:
        told = replay(str(log), *bus_options(udp_port))
        assert told.returncode == 1
        assert "the ids 0x100 are sent by somebody else already" in told.stderr
        assert "Traceback" not in told.stderr
        assert ear.stop() == []
        told = replay(str(log), *bus_options(udp_port), "--without", "0x100")
        assert told.returncode == 0
        assert "sent 0 frames" in told.stdout
    finally:
        stopped.set()
        talker.join()


@pytest.mark.slow
def test_a_part_of_a_log(log: Path, ear: Ear, udp_port: int) -> None:
    window = ["--from", "0.0205", "--to", "0.0505"]
    told = replay(str(log), *bus_options(udp_port), *window)
    assert "sent 30 frames" in told.stdout
    assert len(ear.stop()) == 30


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--commands"], "--commands: needs --config with an override: block"),
        (["--commands", "--loop"], "--loop: does not go with --commands"),
        (["--commands", "--ids", "1"], "--ids: does not go with --commands"),
        (["--commands", "--speed", "2"], "--speed: does not go with --commands"),
        (["--commands", "--dbc", "x.dbc"], "--dbc: does not go with --commands"),
        (["--commands", "--paused"], "--paused: does not go with --commands"),
        (["--commands", "--listen", "2"], "--listen: does not go with --commands"),
        (["--from", "2", "--to", "1"], "--to: 1: is not after --from"),
        (["--from", "99"], "--from: 99: is after the end of the log"),
        (["--without", "zz"], "--without: zz: is not a CAN id"),
        (["--dbc", "nowhere.dbc"], "nowhere.dbc: no such file"),
    ],
)
def test_mistakes_are_one_line(
    words: list[str], said: str, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bus = [] if "--commands" in words else ["--interface", "virtual", "--channel", "1"]
    assert main(["replay", str(log), *bus, *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    "words", [["--interface", "virtual"], ["--channel", "1"], ["--option", "a=1"], ["--fd"]]
)
def test_the_torques_of_a_log_go_to_the_configured_bus_alone(
    words: list[str], log: Path, udp_port: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = config_file(tmp_path, udp_port, override=True)
    assert main(["replay", str(log), "--config", str(config), "--commands", *words]) == 2
    assert f"{words[0]}: does not go with --commands" in capsys.readouterr().err


def test_commands_need_the_override_block(
    log: Path, udp_port: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = config_file(tmp_path, udp_port, override=False)
    assert main(["replay", str(log), "--config", str(config), "--commands"]) == 2
    assert "so no torque may ever be commanded" in capsys.readouterr().err


def test_commands_need_a_dead_man(log: Path, ear: Ear, udp_port: int, tmp_path: Path) -> None:
    config = config_file(tmp_path, udp_port, override=True)
    told = replay(str(log), "--config", str(config), "--commands")
    assert told.returncode == 2
    assert "nobody can hold the dead-man key" in told.stderr
    assert ear.stop() == []


def ramp_log() -> list[Frame]:
    torque = FrameEncoder(DATABASE, "EPSHIL_TorqueOverride")
    frames = []
    for k in range(600):
        value = 0.03 * min(k, 300, 600 - k) / 300
        frame = torque.frame({"RequestedMotorTorque": value, "OverrideRequest": 1})
        frames.append(replace(frame, t_ns=1_790_000_000_000_000_000 + k * 1_000_000))
    return frames


@pytest.mark.slow
def test_commands_go_through_an_armed_session(
    log: Path, ear: Ear, udp_port: int, tmp_path: Path
) -> None:
    """Against the rig's process: the torques arrive, each frame the session's own. A machine that
    is kept busy may be late, and the guard is right to end it then: again."""
    log.write_text(candump(ramp_log()))
    config = config_file(tmp_path, udp_port, override=True)
    words = [sys.executable, "-m", "eps_hil.cli", "rig", "--config", str(config), "--loop"]
    rig = subprocess.Popen(words, stdout=subprocess.DEVNULL)
    journal = tmp_path / "j.jsonl"
    try:
        until_s = time.monotonic() + 120
        while not ear.frames and time.monotonic() < until_s:
            time.sleep(0.05)
        options = ["--commands", "--journal", str(journal), "--yes-i-stand-clear"]
        for _ in range(6):
            told = replay(str(log), "--config", str(config), *options)
            if told.returncode != 3 or "ended the run: clock" not in told.stderr:
                break
    finally:
        rig.kill()
        rig.wait()
    assert told.returncode == 0, told.stdout + told.stderr
    assert "asked for 600 of 600 commands" in told.stdout
    message = DATABASE.get_message_by_name("EPSHIL_TorqueOverride")
    sent = [message.decode(f.data, decode_choices=False) for f in ear.stop() if f.can_id == 0x80]
    assert max(one["RequestedMotorTorque"] for one in sent) == pytest.approx(0.03, abs=2e-4)
    assert [one["OverrideRequest"] for one in sent[-10:]] == [0] * 10
    assert "arming, second step" in journal.read_text()


@pytest.mark.parametrize("over", [True, False])
def test_torques_that_were_not_asked_for_are_no_success(
    over: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ended by a key or SIGTERM before anything was armed, it was status 0."""
    source = SimpleNamespace(done=(600 if over else 0, 600), over=over)
    if over:
        _say_done(source)
        assert "asked for 600 of 600 commands" in capsys.readouterr().out
    else:
        with pytest.raises(EpsHilError, match="stopped: asked for 0 of 600 commands"):
            _say_done(source)


def test_a_signal_while_the_log_is_read_is_kept(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended a replay that was asked to start paused, and had not come to its first frame."""
    took: list[bool] = []

    def slow(*_: object) -> None:
        took.append(callable(signal.getsignal(signal.SIGUSR2)))
        if took[0]:  # or it would end this process
            os.kill(os.getpid(), signal.SIGUSR2)
        raise InputError("bus.log", "", "cannot be read")

    before = signal.getsignal(signal.SIGUSR1), signal.getsignal(signal.SIGUSR2)
    monkeypatch.setattr("eps_hil.cli.replay._commands", slow)
    try:
        assert main(["replay", str(log), "--paused"]) == 2
    finally:
        signal.signal(signal.SIGUSR1, before[0])
        signal.signal(signal.SIGUSR2, before[1])
    assert took == [True]
