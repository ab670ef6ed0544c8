"""``eps-hil calibrate`` as a person meets it: against the rig's process, a dry run, mistakes."""

import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port, open_port
from eps_hil.cli._levels import accept
from eps_hil.cli.calibrate import journal_place
from eps_hil.cli.main import main
from eps_hil.errors import EpsHilError
from eps_hil.physics.model import load_model
from eps_hil.service.calibrated_model import Levels
from eps_hil.service.calibration import calibration_settings
from eps_hil.service.config import load_config
from eps_hil.service.guard import Trip
from eps_hil.service.override import State
from eps_hil.service.override_session import OverrideSession

ROOT = Path(__file__).parents[2]
CHANNEL = "239.74.163.82"
COMMAND = 0x80
OURS = {COMMAND, 0x140}


def test_the_journal_lies_beside_the_model_that_it_tells_of(tmp_path: Path) -> None:
    model, said = tmp_path / "m.yaml", tmp_path / "j.jsonl"
    assert journal_place(None, model) == tmp_path / "override-journal.jsonl"
    assert journal_place(None, None) == Path("override-journal.jsonl")
    assert journal_place(said, model) == said


def port_number(folder: Path) -> int:
    return 44_000 + hash(str(folder)) % 10_000


def write_config(folder: Path, bus: str, extra: str = "") -> Path:
    text = (ROOT / "configs" / "calibrate_udp.yaml").read_text()
    text = text[text.index("dbc:") :].replace("../dbc", f"{ROOT}/dbc")
    text = text.replace("signals: ", f"signals: {ROOT}/configs/")
    text = text.replace("model: ", f"model: {ROOT}/configs/")
    path = folder / "c.yaml"
    path.write_text(f"bus: {bus}\n{text}{extra}")
    return path


def udp(folder: Path) -> str:
    options = f"{{port: {port_number(folder)}, hop_limit: 0}}"
    return f"{{interface: udp_multicast, channel: {CHANNEL}, fd: true, options: {options}}}"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return write_config(tmp_path, udp(tmp_path))


class Ear(threading.Thread):
    """Everything that is on the bus."""

    def __init__(self, port: Port) -> None:
        super().__init__()
        self.frames: list[Frame] = []
        self._port, self._stopped = port, threading.Event()
        self.start()

    def run(self) -> None:
        while not self._stopped.is_set():
            self.frames += self._port.recv(0.05)

    def stop(self) -> None:
        self._stopped.set()
        self.join()
        self._port.close()

    def ours(self) -> list[Frame]:
        return [frame for frame in self.frames if frame.can_id in OURS]


@pytest.fixture
def ear(tmp_path: Path) -> Iterator[Ear]:
    options = {"port": port_number(tmp_path), "hop_limit": 0}
    made = Ear(open_port("udp_multicast", CHANNEL, fd=True, send_ids=(), options=options))
    yield made
    made.stop()


@pytest.fixture
def manoeuvre() -> str:
    return "parked"


@pytest.fixture
def rig(config: Path, ear: Ear, manoeuvre: str) -> Iterator[None]:
    words = ["rig", "--config", str(config), "--manoeuvre", manoeuvre]
    process = subprocess.Popen(
        [sys.executable, "-m", "eps_hil.cli", *words], stdout=subprocess.DEVNULL
    )
    end = time.monotonic() + 200
    while not ear.frames and time.monotonic() < end:
        time.sleep(0.05)
    yield
    process.kill()
    process.wait()


def calibrate(*words: str, seconds: float = 250.0) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "eps_hil.cli", "calibrate", *words],
        capture_output=True,
        text=True,
        timeout=seconds,
        stdin=subprocess.DEVNULL,
        check=False,
    )


def calibrate_in_time(ear: Ear, *words: str) -> "subprocess.CompletedProcess[str]":
    """A machine that is kept busy may be late, here or in the rig's process, and the guard is right
    to end the run: then again.

    Whatever ended it, the last thing on the bus is no request for torque.
    """
    late = re.compile("ended the run: (clock|stale input|invalid input|frozen input|ecu status)")
    message = load_database([ROOT / "dbc" / "eps_rig.dbc"]).get_message_by_frame_id(COMMAND)
    for _ in range(6):
        told = calibrate(*words)
        time.sleep(0.2)
        last = [frame for frame in ear.frames if frame.can_id == COMMAND][-1:]
        last_request = [
            message.decode(f.data, decode_choices=False)["OverrideRequest"] for f in last
        ]
        assert last_request == [0], told.stdout
        if told.returncode != 3 or not late.search(told.stderr):
            return told
    pytest.fail(f"this machine keeps no time: {told.stdout}")


@pytest.mark.slow
@pytest.mark.usefixtures("rig")
def test_dry_run_then_a_run_that_finds_the_levels(config: Path, ear: Ear, tmp_path: Path) -> None:
    told = calibrate("torque-injection", "--config", str(config), "--dry-run", "--duration", "1.5")
    assert told.returncode == 0, told.stderr
    assert "send       nothing (dry run)" in told.stdout
    assert "gate       vehicle_speed_m_s met" in told.stdout
    assert ear.frames
    assert ear.ours() == [], "a dry run sends nothing at all"
    text = config.read_text() + "calibration: {torque_injection: {repetitions: 1}}\n"
    config.write_text(text)
    out, journal = tmp_path / "m.yaml", tmp_path / "j.jsonl"
    options = ("--write-model", str(out), "--journal", str(journal), "--yes-i-stand-clear")
    told = calibrate_in_time(ear, "torque-injection", "--config", str(config), *options)
    assert told.returncode == 0, told.stdout + told.stderr
    friction = load_model(out).friction
    assert friction.offset_pos_nm == pytest.approx(0.0560, rel=0.03)
    assert friction.offset_neg_nm == pytest.approx(0.1258, rel=0.03)
    (entry,) = yaml.safe_load(out.read_text())["calibrations"]
    assert entry["before"] == {"offset_pos_nm": 0.056, "offset_neg_nm": 0.1258}
    assert journal.read_text().splitlines()[-1].count('"to": "off"') == 1
    assert {frame.can_id for frame in ear.ours()} == OURS
    assert re.search(r"k0\+ +0\.05\d\d Nm  \(95 %", told.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("manoeuvre", ["near_centre"])
@pytest.mark.usefixtures("rig")
def test_error_injection_finds_the_levels_of_a_rig(config: Path, ear: Ear, tmp_path: Path) -> None:
    """The model believes in levels that are 40 % off; the rig obeys its own."""
    true = load_model(ROOT / "configs" / "reference_rig.yaml").friction
    wrong = (ROOT / "configs" / "reference_rig.yaml").read_text()
    wrong = wrong.replace("5.600e-2", "3.9e-2").replace("1.258e-1", "1.7e-1")
    (tmp_path / "wrong.yaml").write_text(wrong)
    text = config.read_text().replace(f"{ROOT}/configs/reference_rig.yaml", "wrong.yaml")
    config.write_text(
        text + "calibration: {error_sliding_s: 1.2, error_injection: {gain_per_s: 5}}\n"
    )
    out = tmp_path / "m.yaml"
    told = calibrate("error-injection", "--config", str(config), "--write-model", str(out))
    assert told.returncode == 0, told.stdout + told.stderr
    assert "gate       vehicle_speed_m_s met" in told.stdout
    found = load_model(out).friction
    assert found.offset_pos_nm == pytest.approx(true.offset_pos_nm, rel=0.03)
    assert found.offset_neg_nm == pytest.approx(true.offset_neg_nm, rel=0.03)
    (entry,) = yaml.safe_load(out.read_text())["calibrations"]
    assert entry["method"] == "error_injection"
    assert min(entry["sliding_s"]) >= 1.2
    assert ear.ours() == [], "it only listens"


@pytest.mark.parametrize("verb", ["error-injection", "torque-injection"])
def test_a_silent_bus_ends_it_with_one_line(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    blocks = "calibration: {silence_s: 0.3}\nservice: {realtime: off}\n"
    config.write_text(config.read_text() + blocks)
    words = ["calibrate", verb, "--config", str(config)]
    if verb == "torque-injection":
        words += ["--yes-i-stand-clear", "--journal", str(tmp_path / "j.jsonl")]
    assert main(words) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "no frame EPS_MotorState for 0.3 s; is the rig on this bus?" in said


def test_a_dry_run_on_a_silent_bus_says_so(
    config: Path, ear: Ear, capsys: pytest.CaptureFixture[str]
) -> None:
    config.write_text(config.read_text() + "service: {realtime: off}\n")
    words = ["calibrate", "torque-injection", "--config", str(config), "--dry-run"]
    assert main([*words, "--duration", "0.3"]) == 1
    assert "no sync frame was received" in capsys.readouterr().err
    assert ear.ours() == []


def test_a_trip_ends_it_with_status_3_and_its_reasons(
    config: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The session is the real one; only that an armed one tripped is put into it."""
    config.write_text(config.read_text() + "service: {realtime: off}\n")
    model = tmp_path / "m.yaml"

    async def tripped(session: OverrideSession, _: float | None = None) -> None:
        session.core.start(0)
        session.core.override.state = State.INJECTING
        session.core.override.trip(1, Trip.DRIVER | Trip.CLOCK)
        session._record()

    monkeypatch.setattr(OverrideSession, "run", tripped)
    words = ["calibrate", "torque-injection", "--config", str(config), "--yes-i-stand-clear"]
    journal = str(tmp_path / "j.jsonl")
    assert main([*words, "--journal", journal, "--write-model", str(model)]) == 3
    assert "the torque guard ended the run: driver, clock" in capsys.readouterr().err
    assert not model.exists()


@pytest.mark.slow
def test_nobody_at_the_terminal_and_nobody_says_so(config: Path, ear: Ear) -> None:
    told = calibrate("torque-injection", "--config", str(config))
    assert told.returncode == 2
    assert "nobody can hold the dead-man key" in told.stderr
    assert told.stderr.count("\n") == 1
    assert ear.ours() == []


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("max_torque_nm: 0.4 ", "max_torque_nm: 4.0 ", "override.limits.max_torque_nm"),
        (
            "max_torque_nm: 0.4 ",
            "max_torque_nm: 0.3 ",
            "calibration.torque_injection.max_torque_nm",
        ),
        ("max_torque_nm: 0.4 ", "max_torque_nm: 0.05 ", "max_torque_error_nm 0.05 is not below"),
        (
            "rig:",
            "calibration:\n  torque_injection: {gates: {yaw_rate_rad_s: {limit: 1, filter_s: 9}}}\n"
            "rig:",
            "gates.yaw_rate_rad_s.filter_s: Input should be less than or equal to 1 (found 9)",
        ),
        (
            "rig:",
            "calibration: {torque_injection: {gates_hold_s: 0.1}}\nrig:",
            "gates.lateral_acceleration_m_s2.filter_s 0.3 is longer than gates_hold_s 0.1",
        ),
        ("override:", "no_override:", "no_override: is not a known field"),
        ("rig:", "calibration: {sanity_band: 2}\nrig:", "calibration.sanity_band"),
    ],
)
def test_a_mistake_is_status_2_and_one_line(
    config: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    text = config.read_text()
    assert old in text
    config.write_text(text.replace(old, new, 1))
    assert main(["calibrate", "torque-injection", "--config", str(config), "--dry-run"]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert str(config) in err
    assert err.count("\n") == 1


def test_without_the_override_block_it_refuses(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = config.read_text()
    config.write_text(text[: text.index("override:")])
    assert main(["calibrate", "torque-injection", "--config", str(config)]) == 2
    assert "so no torque may ever be commanded" in capsys.readouterr().err


def test_levels_that_moved_apart_since_the_last_calibration_are_refused(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """40 N at a parked rack; on a first calibration it is a note, and the intervals are wider."""
    setup, out = load_config(config), tmp_path / "m.yaml"
    settings = calibration_settings(setup, config)
    first = Levels(0.058, 0.1239, (0.057, 0.059), (0.123, 0.125))
    pushed = Levels(0.074, 0.108, (0.073, 0.075), (0.107, 0.109))
    accept(pushed, setup, settings, out, {"method": "torque_injection"}, insist=False)
    said = capsys.readouterr().out
    assert "an unknown rack force of about 45 N would explain this" in said
    assert "k0+        0.0740 Nm  (95 %: 0.0551 to 0.0750)" in said
    (entry,) = yaml.safe_load(out.read_text())["calibrations"]
    assert entry["rack_force_that_would_explain_it_n"] == pytest.approx(45.0, abs=1.0)
    accept(first, setup, settings, out, {"method": "torque_injection"}, insist=False)
    assert "unknown rack force" not in capsys.readouterr().out
    known = replace(setup, model=out)
    with pytest.raises(EpsHilError, match=r"refused: the levels moved apart .* about 40 N"):
        accept(pushed, known, settings, out, {"method": "error_injection"}, insist=False)
    accept(pushed, known, settings, out, {"method": "error_injection"}, insist=True)
    assert load_model(out).friction.offset_pos_nm == 0.074


def test_the_model_is_written_though_nobody_reads_what_is_said(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(*_: object, **__: object) -> None:
        raise BrokenPipeError

    setup, out = load_config(config), tmp_path / "m.yaml"
    settings = calibration_settings(setup, config)
    monkeypatch.setattr("typer.echo", gone)
    with pytest.raises(BrokenPipeError):
        accept(Levels(0.058, 0.1239), setup, settings, out, {}, insist=False)
    assert load_model(out).friction.offset_pos_nm == 0.058


@pytest.mark.parametrize("verb", ["torque-injection", "error-injection"])
def test_a_model_that_cannot_be_changed_is_refused_before_anything_moves(
    config: Path, capsys: pytest.CaptureFixture[str], verb: str, tmp_path: Path
) -> None:
    content = yaml.safe_load((ROOT / "configs" / "reference_rig.yaml").read_text())
    model = tmp_path / "flow.yaml"
    model.write_text(yaml.safe_dump(content, default_flow_style=True))
    config.write_text(config.read_text().replace(f"{ROOT}/configs/reference_rig.yaml", str(model)))
    words = ["calibrate", verb, "--config", str(config), "--duration", "0.3"]
    assert main([*words, "--write-model", str(tmp_path / "m.yaml")]) == 2
    assert "offset_pos_nm: is not on one line of its own" in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["torque-injection", "error-injection"])
def test_reset_needs_something_to_reset_and_a_file(
    config: Path, capsys: pytest.CaptureFixture[str], verb: str, tmp_path: Path
) -> None:
    words = ["calibrate", verb, "--config", str(config), "--reset"]
    assert main(words) == 2
    assert "--write-model" in capsys.readouterr().err
    assert main([*words, "--write-model", str(tmp_path / "m.yaml")]) == 2
    assert "holds no calibration" in capsys.readouterr().err
    assert not (tmp_path / "m.yaml").exists()


def test_error_injection_without_a_rig_says_so(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["calibrate", "error-injection", "--config", str(config), "--duration", "0.3"]
    assert main(words) == 1
    assert "no sync frame was received" in capsys.readouterr().err
