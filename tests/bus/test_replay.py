"""A log goes onto the bus with its own spacing, and a bad log is refused in one line."""

import contextlib
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from itertools import islice
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.bus import replay
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Deliver, OnLost, PortCounts, open_port
from eps_hil.bus.replay_choice import Choice
from eps_hil.cli.main import main
from eps_hil.errors import InputError
from eps_hil.recordings.conversion import write_log

LOG = "(1757617431.821276) can0 167#727FC3000019E500\n(1757617431.831276) can0 204#C000\n"


class Sink:
    """A port that notes what is sent and when."""

    name = "sink"
    state = BusState.UNKNOWN
    counts = PortCounts()

    def __init__(self, accept: bool = True) -> None:
        self.sent: list[tuple[int, Frame]] = []
        self._accept = accept

    def send(self, frame: Frame) -> bool:
        self.sent.append((time.monotonic_ns(), frame))
        return self._accept

    def start(self, loop: object, deliver: Deliver, on_lost: OnLost | None = None) -> None:
        raise NotImplementedError

    def recv(self, timeout_s: float) -> list[Frame]:
        raise NotImplementedError

    def close(self) -> None:
        raise NotImplementedError


def test_frames_leave_at_their_own_pace_and_lateness_does_not_add_up() -> None:
    frames = [Frame(10**18 + k * 2_000_000, 0x100 + k, b"") for k in range(150)]
    sink = Sink()
    report = replay.replay(frames, sink, speed=1.0)
    times = [t for t, _ in sink.sent]
    # No frame early; the last one as late as any, so nothing has accumulated.
    assert all(t - times[0] >= k * 2_000_000 - 500_000 for k, t in enumerate(times))
    assert report.wall_s == pytest.approx(0.298, abs=0.1)
    assert report.log_s == pytest.approx(0.298)
    assert (report.sent, report.dropped, report.skipped, report.stopped) == (150, 0, 0, False)
    assert 0 <= report.late_p50_ns <= report.late_p99_ns <= report.late_max_ns


def test_speed_scales_the_pace_and_max_does_not_wait() -> None:
    frames = [Frame(k * 100_000_000, 1, b"") for k in range(11)]
    assert 0.09 < replay.replay(frames, Sink(), speed=10.0).wall_s < 0.5
    assert replay.replay(frames, Sink(), speed=None).wall_s < 0.09


def test_error_frames_and_other_ids_are_not_played() -> None:
    frames = [Frame(0, 1, b""), Frame(0, 2, b""), Frame(0, 1, b"", error=True)]
    sink = Sink(accept=False)
    report = replay.replay(frames, sink, choice=Choice(ids={1}))
    assert [f.can_id for _, f in sink.sent] == [1]
    assert (report.sent, report.dropped, report.skipped) == (0, 1, 2)


def test_a_clock_that_was_set_back_carries_on() -> None:
    stamps = [100_000, 300_000, 200_000, -(10**15), 100_000 - 10**15]
    found = [t for t, _ in replay.offsets(Frame(t, 1, b"") for t in stamps)]
    assert found == [0, 200_000, 100_000, 200_000, 300_000]


def test_a_loop_is_one_stream_of_time() -> None:
    log = [Frame(5_000, 1, b""), Frame(9_000, 2, b"")]
    stream = islice(replay.again(lambda: log, rest_ns=1_000), 6)
    assert [f.t_ns for f in stream] == [5_000, 9_000, 10_000, 14_000, 15_000, 19_000]


def test_a_stop_request_ends_a_long_wait() -> None:
    asked_s = time.monotonic() + 0.1
    frames = [Frame(0, 1, b""), Frame(10**12, 2, b"")]
    report = replay.replay(frames, Sink(), stop=lambda: time.monotonic() > asked_s)
    assert report.stopped
    assert report.sent == 1
    assert report.wall_s < 2.0


def test_a_stop_is_heard_where_nothing_of_the_log_is_played() -> None:
    def log() -> list[Frame]:
        passes.append(0)
        assert len(passes) < 10_000, "the loop does not end"
        return [Frame(0, 1, b"")]

    passes: list[int] = []
    report = replay.replay(
        replay.again(log), Sink(), choice=Choice(ids={2}), stop=lambda: len(passes) > 1_000
    )
    assert report.stopped
    assert report.sent == 0


@given(st.lists(st.integers(0, 2_000_000), min_size=1))
def test_the_quantiles_bound_what_they_should(late_ns: list[int]) -> None:
    histogram = replay.Lateness()
    for one in late_ns:
        histogram.add(one)
    for share in (0.5, 0.99):
        bound = histogram.quantile_ns(share)
        assert sum(one <= bound for one in late_ns) >= share * len(late_ns)
    assert histogram.max_ns == max(late_ns)


def test_the_log_is_read_with_its_stamps(tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    log.write_text(LOG)
    first, second = replay.read_log(log)
    assert (first.can_id, first.data.hex()) == (0x167, "727fc3000019e500")
    assert second.can_id == 0x204
    assert abs(second.t_ns - first.t_ns - 10_000_000) < 500  # a float of epoch seconds: ±240 ns


def test_an_asc_log_is_read_by_the_base_of_its_numbers(tmp_path: Path) -> None:
    """Whatever stands above it; and what is asked to be sent is not sent twice."""
    log = tmp_path / "a.asc"
    log.write_text(
        "// a comment\ndate 10.09.2025 12:00:00\nbase dec  timestamps absolute\n"
        "0.001 1 288 TxRq d 2 10 20\n0.002 1 288 Tx d 2 10 20\n0.003 2 80 Rx d 1 16\n"
    )
    read = [(frame.can_id, frame.data) for frame in replay.read_log(log)]
    assert read == [(288, b"\x0a\x14"), (80, b"\x10")]
    assert [frame.can_id for frame in replay.read_log(log, "2")] == [80]
    log.write_text("base hex  timestamps relative\n0.001 1 120 Rx d 1 10\n")
    with pytest.raises(InputError, match="time stamps are relative to the event before"):
        list(replay.read_log(log))


def test_a_buss_number_is_the_logs_own_in_every_format(tmp_path: Path) -> None:
    frames = [(f"can{k}", Frame(t_ns=10**9 + k, can_id=k, data=b"")) for k in range(3)]
    for suffix in ("blf", "asc", "mf4"):
        log = tmp_path / f"a.{suffix}"
        write_log(log, frames, 10**9)
        for k in range(3):
            assert [frame.can_id for frame in replay.read_log(log, f"{k + 1}")] == [k]
    log = tmp_path / "a.trc"
    log.write_text(";$FILEVERSION=1.1\n;$STARTTIME=45000.5\n     1)     1.0  Rx     0120  1  10\n")
    assert [frame.can_id for frame in replay.read_log(log, "1")] == [0x120]


BAD = {
    "missing.log": (None, "no such file"),
    "empty.log": (b"", "holds no CAN frames"),
    "empty.blf": (b"", "at the beginning: not readable as a blf log"),
    "noise.blf": (bytes(range(256)) * 16, "at the beginning: not readable as a blf log"),
    "noise.asc": (bytes(range(256)) * 16, "noise.asc: "),
    "noise.trc": (bytes(range(256)) * 16, "noise.trc: "),
    "noise.mf4": (bytes(range(256)) * 16, "noise.mf4: "),
    "noise.db": (bytes(range(256)) * 16, "noise.db: "),
    "noise.csv": (bytes(range(256)) * 16, "noise.csv: "),
    "prose.log": (b"this is not\na log at all\n", "at the beginning: not readable"),
    "broken.log": (LOG.encode() + b"(17.0) can0 1#0G\n", "after frame 2: not readable"),
    "nan.log": (b"(nan) can0 123#00\n", "at the beginning: not readable"),
    "long.log": (b"(1.0) can0 123#001122334455667788\n", "at the beginning: not readable"),
    "table.pdf": (b"x", "'.pdf' is not a format of CAN logs; use .log"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_log_is_one_line_with_file_and_place(name: str, tmp_path: Path) -> None:
    content, said = BAD[name]
    log = tmp_path / name
    if content is not None:
        log.write_bytes(content)
    with pytest.raises(InputError) as caught:
        list(replay.read_log(log))
    text = str(caught.value)
    assert text.startswith(str(log))
    assert said in text
    assert "\n" not in text


@given(st.binary(max_size=300))
def test_no_bytes_at_all_make_it_crash(noise: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".log", ".blf", ".asc"):
            log = Path(folder, f"x{suffix}")
            log.write_bytes(noise)
            with contextlib.suppress(InputError):
                assert list(replay.read_log(log))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--interface", "virtual", "--channel", "1", "--speed", "fast"], "--speed: fast"),
        (["--interface", "virtual", "--channel", "1", "--ids", "0x1,zz"], "--ids: zz"),
        (["--interface", "virtual"], "--channel"),
        ([], "--interface"),
        (["--interface", "virtual", "--channel", "1", "--option", "oops"], "KEY=VALUE"),
    ],
)
def test_the_verb_refuses_what_it_does_not_understand(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "a.log"
    log.write_text(LOG)
    assert main(["replay", str(log), *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_the_verb_plays_onto_a_bus_and_stops_cleanly(tmp_path: Path, udp_port: int) -> None:
    log = tmp_path / "a.log"
    log.write_text("".join(f"({k * 0.001:.6f}) can0 123#{k:04X}\n" for k in range(500)))
    port = open_port("udp_multicast", "239.74.163.2", options={"port": udp_port})
    words = [sys.executable, "-m", "eps_hil.cli", "replay", str(log), "--loop"]
    words += ["--interface", "udp_multicast", "--option", f"port={udp_port}"]
    run = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    got: list[Frame] = []
    while len(got) < 700:
        got += port.recv(20.0)
    os.kill(run.pid, signal.SIGINT)
    out, error = run.communicate(timeout=20)
    port.close()
    assert run.returncode == 0, error
    assert "stopped: sent" in out
    assert "lateness: p50" in out
    assert [struct.unpack(">H", f.data)[0] for f in got[:700]] == [k % 500 for k in range(700)]
