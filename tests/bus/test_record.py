"""A recording is readable whatever ends it."""

import signal
import struct
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from eps_hil.bus import record, record_parts, recorder, replay
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Deliver, OnLost, Port, PortCounts, open_port
from eps_hil.cli.main import main
from eps_hil.errors import BusError, InputError

SendAll = Callable[[Port, Iterable[Frame]], None]

GROUP = "239.74.163.2"
SUFFIXES = pytest.mark.parametrize("suffix", [".log", pytest.param(".blf", marks=pytest.mark.slow)])


class Source:
    """A port that receives prepared batches, then nothing, or the end of the bus."""

    name = "source"
    state = BusState.UNKNOWN
    counts = PortCounts(lost_in_kernel=3, error_frames=1)

    def __init__(self, batches: list[list[Frame]], end: str = "") -> None:
        self._batches, self._end = list(batches), end

    @property
    def empty(self) -> bool:
        return not self._batches

    def recv(self, timeout_s: float) -> list[Frame]:
        if self._batches:
            return self._batches.pop(0)
        if self._end:
            raise BusError(self._end)
        return []

    def send(self, frame: Frame) -> bool:
        raise NotImplementedError

    def start(self, loop: object, deliver: Deliver, on_lost: OnLost | None = None) -> None:
        raise NotImplementedError

    def close(self) -> None:
        """Nothing to close."""


def recorded(
    out: Path, source: "Source", stop: Callable[[], bool] | None = None
) -> recorder.RecordReport:
    """A recording of one channel that ends when nothing waits any more."""
    channel = recorder.Channel("239.74.163.2", lambda: source, reconnect=False)
    made = recorder.Recorder([channel], record_parts.Target(out))
    return made.run(stop=stop or (lambda: source.empty))


EPOCH_NS = 1_757_617_431_000_000_000
FRAMES = [
    Frame(EPOCH_NS, 0x123, b"\x01\x02"),
    Frame(EPOCH_NS + 1_000_000, 0x18FF0000, b"", extended=True),
    Frame(EPOCH_NS + 2_000_000, 0x7FF, bytes(64), fd=True, brs=True),
    Frame(EPOCH_NS + 3_000_000, 0x7FF, b"", remote=True),
]


@SUFFIXES
def test_what_is_received_is_read_back(tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"x{suffix}"
    source = Source([FRAMES[:2], [], FRAMES[2:]])
    report = recorded(out, source)
    assert (report.frames, report.lost, report.error_frames) == (4, 3, 1)
    assert report.file_bytes == out.stat().st_size
    back = list(replay.read_log(out))
    for sent, got in zip(FRAMES, back, strict=True):
        assert (got.can_id, got.data, got.extended, got.fd, got.remote, got.brs) == (
            sent.can_id,
            sent.data,
            sent.extended,
            sent.fd,
            sent.remote,
            sent.brs,
        )
        assert abs(got.t_ns - sent.t_ns) <= 1_000  # candump's microsecond


@SUFFIXES
def test_what_an_error_frame_says_is_kept(tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"x{suffix}"
    error = Frame(EPOCH_NS, 0x004, bytes([0, 8, 0, 0, 0, 0, 96, 0]), error=True)
    source = Source([[error]])
    recorded(out, source)
    (got,) = replay.read_log(out)
    assert (got.error, got.can_id, got.data) == (True, error.can_id, error.data)


@SUFFIXES
def test_a_bus_that_ends_leaves_a_whole_file(tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"x{suffix}"
    source = Source([FRAMES], end="vcan0: the interface went down")
    with pytest.raises(recorder.RecordError, match=r"went down; .* holds the 4 frames") as caught:
        recorded(out, source, stop=lambda: False)
    assert caught.value.exit_status == 1
    assert len(list(replay.read_log(out))) == 4


@SUFFIXES
def test_what_waits_at_the_stop_is_written_and_the_bus_may_go_then(
    tmp_path: Path, suffix: str
) -> None:
    out = tmp_path / f"x{suffix}"
    source = Source([FRAMES[:2], FRAMES[2:]], end="vcan0: the interface went down")
    report = recorded(out, source, stop=lambda: True)
    assert report.frames == len(list(replay.read_log(out))) == 4


@SUFFIXES
def test_a_killed_recorder_loses_under_a_second(
    tmp_path: Path, suffix: str, udp_port: int, send_all: SendAll
) -> None:
    out = tmp_path / f"x{suffix}"
    recorder = start_recorder(out, udp_port)
    sender = open_port("udp_multicast", GROUP, options={"port": udp_port})
    started_s = time.monotonic()
    sent_at_s: list[float] = []
    while time.monotonic() - started_s < 2.0:
        send_all(sender, [Frame(0, 0x10, struct.pack("<I", len(sent_at_s)))])
        sent_at_s.append(time.monotonic())
        time.sleep(0.001)
    recorder.kill()
    killed_s = time.monotonic()
    recorder.wait(10)
    sender.close()
    got = [struct.unpack("<I", f.data)[0] for f in replay.read_log(out)]
    assert got == list(range(len(got)))
    assert killed_s - sent_at_s[got[-1]] < 1.2
    first = next(replay.read_log(out))
    assert abs(first.t_ns - time.time_ns()) < 60_000_000_000  # dated, though never closed


@pytest.mark.parametrize(
    "number", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), signal.SIGTERM]
)
def test_a_signal_ends_it_cleanly(
    tmp_path: Path, udp_port: int, send_all: SendAll, number: signal.Signals
) -> None:
    out = tmp_path / "x.blf"
    recorder = start_recorder(out, udp_port)
    sender = open_port("udp_multicast", GROUP, options={"port": udp_port})
    send_all(sender, (Frame(0, 0x10, struct.pack("<I", k)) for k in range(300)))
    sender.close()
    time.sleep(0.3)
    recorder.send_signal(number)
    said, error = recorder.communicate(timeout=20)
    assert recorder.returncode == 0, error
    assert "recorded 300 frames in" in said
    assert "lost in the kernel 0" in said
    assert len(list(replay.read_log(out))) == 300


def test_what_waited_when_the_stop_came_is_kept(
    tmp_path: Path, udp_port: int, send_all: SendAll
) -> None:
    """A machine that was busy elsewhere: 2,000 frames came, none was read, and then the stop."""
    out = tmp_path / "x.blf"
    recorder = start_recorder(out, udp_port)
    sender = open_port("udp_multicast", GROUP, options={"port": udp_port})
    recorder.send_signal(signal.SIGSTOP)
    time.sleep(0.3)  # longer than one wait for frames: it is surely not reading
    send_all(sender, (Frame(0, 0x10, struct.pack("<I", k)) for k in range(2_000)))
    sender.close()
    recorder.send_signal(signal.SIGTERM)
    recorder.send_signal(signal.SIGCONT)
    said, error = recorder.communicate(timeout=20)
    assert recorder.returncode == 0, error
    assert "recorded 2000 frames in" in said
    got = [struct.unpack("<I", frame.data)[0] for frame in replay.read_log(out)]
    assert got == list(range(2_000))


def start_recorder(out: Path, udp_port: int) -> "subprocess.Popen[str]":
    words = [sys.executable, "-m", "eps_hil.cli", "record", str(out)]
    words += ["--interface", "udp_multicast", "--option", f"port={udp_port}"]
    recorder = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert recorder.stderr is not None
    assert recorder.stderr.readline().startswith("recording udp_multicast")
    return recorder


def test_the_verb_stops_after_its_duration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # this process keeps its handlers
    out = tmp_path / "x.log"
    words = ["record", str(out), "--interface", "virtual", "--channel", uuid.uuid4().hex]
    assert main([*words, "--duration", "0.1"]) == 0
    said = capsys.readouterr()
    assert "recorded 0 frames" in said.out
    assert "no frame came" in said.err


def test_the_bus_may_come_from_a_configuration_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    config = tmp_path / "c.yaml"
    config.write_text(f"bus: {{interface: virtual, channel: '{uuid.uuid4().hex}'}}\n")
    words = ["record", str(tmp_path / "x.log"), "--config", str(config), "--duration", "0.1"]
    assert main(words) == 0
    assert "recording virtual:" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("x.mf4", "name the file .log (candump) or .blf"),
        ("nowhere/x.log", "no such folder"),
        ("old.log", "exists already; choose another name, or add --overwrite"),
    ],
)
def test_a_target_that_will_not_do_is_refused(name: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "old.log").write_text("measured data\n")
    with pytest.raises(InputError) as caught:
        record.open_log(tmp_path / name, "can0")
    assert said in str(caught.value)
    assert (tmp_path / "old.log").read_text() == "measured data\n"
    record.open_log(tmp_path / "old.log", "can0", overwrite=True).close()
    assert (tmp_path / "old.log").read_bytes() == b""


def test_each_channel_of_a_candump_log_has_a_name_of_its_own() -> None:
    """An address beside a real can0, one name on two interfaces, a letter that is not ASCII."""
    channels = ["239.74.163.2", "can0", "can0", "vcan1", "büs"]
    assert record.channel_names(channels) == ["can1", "can0", "can2", "vcan1", "can4"]


def test_a_frame_before_the_first_of_a_log_keeps_its_stamp(tmp_path: Path) -> None:
    log = record.open_log(tmp_path / "x.log", ["can0", "can1"])
    log.write([Frame(EPOCH_NS + 5_000_000, 1, b"")], 0)
    log.write([Frame(EPOCH_NS, 2, b"")], 1)
    log.close()
    lines = (tmp_path / "x.log").read_text().splitlines()
    assert [line.split()[0] for line in lines] == ["(1757617431.005000)", "(1757617431.000000)"]
