"""A recording that is left alone: rotation, sidecar, several channels, a full disk, a lost bus."""

import errno
import itertools
import json
import os
import resource
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from eps_hil.bus import record_parts, replay
from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Port, PortCounts, open_port
from eps_hil.bus.record_counts import CounterField, Counts, counters_of
from eps_hil.bus.record_parts import Parts, Target
from eps_hil.bus.record_sidecar import SCHEMA, sidecar_path
from eps_hil.bus.recorder import (
    BUFFER_BYTES,
    Channel,
    Recorder,
    RecordError,
    _in_order,
    _Waiting,
)
from eps_hil.bus.socket_port import SocketPort
from eps_hil.cli.main import main
from eps_hil.errors import BusError, InputError
from eps_hil.recordings.can_log import read_tagged_frames

SendAll = Callable[[Port, Iterable[Frame]], None]
ROOT = Path(__file__).parents[2]
GROUP = "239.74.163.2"
SUFFIXES = pytest.mark.parametrize("suffix", [".log", pytest.param(".blf", marks=pytest.mark.slow)])
T0_NS = 1_790_000_000_000_000_000


def told(log: Path) -> dict[str, Any]:
    content = json.loads(sidecar_path(log).read_text())
    assert content["schema"] == SCHEMA
    return dict(content)


def numbered(first: int, count: int, can_id: int = 0x10) -> list[Frame]:
    return [
        Frame(T0_NS + k * 1_000_000, can_id, struct.pack("<I", k))
        for k in range(first, first + count)
    ]


def numbers(path: Path) -> list[int]:
    return [struct.unpack("<I", frame.data)[0] for frame in replay.read_log(path)]


class Source:
    """A port that hands out batches; an entry that is an exception is raised."""

    state = BusState.UNKNOWN

    def __init__(self, batches: Iterable[list[Frame] | Exception], name: str = "source") -> None:
        self.name = name
        self._batches = iter(batches)
        self.received = 0
        self.empty = False

    @property
    def counts(self) -> PortCounts:
        return PortCounts(received=self.received, lost_in_kernel=7)

    def recv(self, timeout_s: float) -> list[Frame]:
        found = next(self._batches, None)
        if found is None:
            self.empty = True
            time.sleep(0.001)
            return []
        if isinstance(found, Exception):
            raise found
        self.received += len(found)
        return found

    def send(self, frame: Frame) -> bool:
        raise NotImplementedError

    def start(self, *_: object) -> None:
        raise NotImplementedError

    def close(self) -> None:
        pass


def parts_of(target: Target, said: list[str] | None = None, channels: int = 1) -> Parts:
    names = [f"can{k}" for k in range(channels)]
    say = (lambda _: None) if said is None else said.append
    return Parts(target, names, {}, lambda counts: {"channels": [counts.told(0)]}, say)


# Rotation.


@SUFFIXES
@pytest.mark.parametrize("by", ["size", "time"])
def test_rotation_loses_nothing_between_two_files(
    tmp_path: Path, suffix: str, by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record_parts, "FLUSH_S", 0.0)
    size, seconds = (2_000, None) if by == "size" else (None, 0.05)
    target = Target(tmp_path / f"x{suffix}", size, seconds)
    parts = parts_of(target)
    for k in range(40):
        parts.write(0, numbered(100 * k, 100))
        parts.tick()
        if by == "time":
            time.sleep(0.01)
    parts.close()
    assert len(parts.paths) > 4
    assert [path.name for path in parts.paths[:2]] == [f"x_0001{suffix}", f"x_0002{suffix}"]
    assert list(itertools.chain(*map(numbers, parts.paths))) == list(range(4_000))
    assert parts.frames == 4_000
    assert [told(path)["part"] for path in parts.paths] == list(range(1, len(parts.paths) + 1))
    assert sum(told(path)["frames"] for path in parts.paths) == 4_000
    assert {told(path)["state"] for path in parts.paths[:-1]} == {"rotated"}
    assert told(parts.paths[-1])["state"] == "closed"


def test_old_parts_are_refused_or_replaced(tmp_path: Path) -> None:
    old = tmp_path / "x_0007.log"
    old.write_text("measured\n")
    target = Target(tmp_path / "x.log", rotate_s=10.0)
    with pytest.raises(InputError, match=r"x_0007\.log: exists already"):
        parts_of(target)
    assert old.read_text() == "measured\n"
    parts_of(replace(target, overwrite=True)).close()
    assert sorted(path.name for path in tmp_path.glob("*.log")) == ["x_0001.log"]


@SUFFIXES
def test_a_clock_that_is_set_back_begins_a_new_part(tmp_path: Path, suffix: str) -> None:
    """In one log its stamps would be lost, or the log be refused by who reads it."""
    said: list[str] = []
    parts = parts_of(Target(tmp_path / f"x{suffix}"), said)
    back = [replace(one, t_ns=one.t_ns - 3_600 * 10**9) for one in numbered(10, 10)]
    parts.write(0, numbered(0, 10) + back[:5])
    parts.write(0, back[5:])
    parts.close()
    first, second = parts.paths
    assert second.name == f"x_0002{suffix}"
    assert [numbers(path) for path in parts.paths] == [list(range(10)), list(range(10, 20))]
    stamps = [frame.t_ns for frame in replay.read_log(second)]
    assert all(abs(t - one.t_ns) < 1_000 for t, one in zip(stamps, back, strict=True))
    assert told(first)["state"] == "ended: the clock was set back"
    assert said == [f"record     can0: the clock went back by 3600 s; goes on in {second}"]


def test_frames_of_a_clock_that_is_set_back_keep_their_order() -> None:
    before, after, other = (Frame(t_ns, 1, b"") for t_ns in (100, 50, 90))
    found = _in_order([(0, [before, after]), (1, [other])])
    assert found == [(1, [other]), (0, [before, after])]


def test_what_a_part_that_could_not_be_made_cost_is_told_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record_parts, "FLUSH_S", 0.0)
    monkeypatch.setattr(record_parts, "SYNC_S", 0.0)
    parts = parts_of(Target(tmp_path / "x.log", rotate_bytes=10))
    parts.write(0, numbered(0, 5))
    parts.tick()
    foreign = tmp_path / "x_0002.log"
    foreign.write_text("somebody else's\n")
    parts.write(0, numbered(5, 7))
    foreign.unlink()
    parts.tick()
    parts.write(0, numbered(12, 5))
    parts.close()
    assert numbers(foreign) == list(range(12, 17))
    assert told(foreign)["channels"][0]["lost_on_full_disk"] == parts.lost == 7


# The sidecar.


def test_the_sidecar_counts_no_frame_that_a_full_disk_took_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In no message id, either."""

    def full() -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(record_parts, "SYNC_S", 0.0)
    parts = parts_of(Target(tmp_path / "x.log"))
    parts.write(0, numbered(0, 5))
    parts.tick()
    parts.write(0, numbered(5, 7))
    monkeypatch.setattr(parts._log, "sync", full)
    parts.tick()
    (channel,) = told(tmp_path / "x.log")["channels"]
    assert numbers(tmp_path / "x.log") == list(range(5))
    assert (channel["frames"], channel["lost_on_full_disk"]) == (5, 7)
    assert channel["ids"] == {"0x10": {"frames": 5}}


def test_the_sidecar_says_what_is_in_the_log_and_what_is_missing(tmp_path: Path) -> None:
    database = load_database([ROOT / "dbc" / "eps_rig.dbc"])
    encoder = FrameEncoder(database, "EPS_MotorState")
    frames = [encoder.frame({"MotorSpeed": 0.0}, T0_NS + k * 1_000_000) for k in range(300)]
    kept = frames[:100] + frames[103:200] + frames[199:]  # three lost, one twice
    error = Frame(T0_NS, 0x4, bytes(8), error=True)
    source = Source([[*kept, *numbered(0, 5), error]])
    out = tmp_path / "x.log"
    recorder = Recorder(
        [Channel("can0", lambda: source, {"interface": "test"})],
        Target(out),
        about={"versions": {"eps_hil": "x"}},
        counters=counters_of(database),
    )
    recorder.run(stop=lambda: source.empty)
    content = told(out)
    (channel,) = content["channels"]
    assert content["versions"] == {"eps_hil": "x"}
    assert (content["log"], content["state"], content["frames"]) == ("x.log", "closed", 304)
    assert content["ended"] >= content["started"]["utc"]
    assert (channel["name"], channel["interface"], channel["frames"]) == ("can0", "test", 304)
    assert channel["error_frames"] == 1
    assert channel["since_start"] == {
        "received": 304, "lost_in_kernel": 7, "lost_waiting_for_disk": 0,
    }  # fmt: skip
    assert channel["ids"] == {
        "0x10": {"frames": 5},
        "0x100": {"frames": 298, "lost_by_counter": 3, "repeated": 1},
    }


def test_counters_of_any_width_and_place() -> None:
    place = CounterField(start=12, length=4)
    assert place.read(bytes([0xFF, 0x5F])) == 5
    assert place.read(b"\xff") is None
    counts = Counts(1, {(1, True): place})
    frames = [Frame(0, 1, bytes([0, k << 4]), extended=True) for k in (14, 15, 0, 3, 3)]
    counts.take(0, [*frames, Frame(0, 1, bytes(2))])
    assert counts.told(0)["ids"] == {
        "0x1": {"frames": 1},
        "0x1x": {"frames": 5, "lost_by_counter": 2, "repeated": 1},
    }


def test_a_counter_that_ends_before_its_last_value_has_lost_nothing(tmp_path: Path) -> None:
    """Profile 1 counts 0 to 14: from 14 to 0 no frame is missing."""
    dbc = tmp_path / "x.dbc"
    dbc.write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 256 M: 8 A\n SG_ Count : 0|4@1+ (1,0) [0|14] "" A\n'
        'BA_DEF_ SG_ "GenSigFuncType" STRING ;\nBA_DEF_DEF_ "GenSigFuncType" "";\n'
        'BA_ "GenSigFuncType" SG_ 256 Count "CNTR";\n'
    )
    counts = Counts(1, counters_of(load_database([dbc])))
    counts.take(0, [Frame(k, 256, bytes([k % 15, *bytes(7)])) for k in range(150) if k != 40])
    assert counts.told(0)["ids"]["0x100"] == {"frames": 149, "lost_by_counter": 1, "repeated": 0}


@pytest.mark.slow
def test_a_killed_recorder_leaves_a_true_sidecar(
    tmp_path: Path, udp_port: int, send_all: SendAll
) -> None:
    """It claims no frame that the log does not hold, and says that it was not ended."""
    out = tmp_path / "x.blf"
    recorder = start_recorder(out, "--option", f"port={udp_port}", "--channel", GROUP)
    sender = open_port("udp_multicast", GROUP, options={"port": udp_port, "hop_limit": 0})
    started_s, k = time.monotonic(), 0
    while time.monotonic() - started_s < 2.5:
        send_all(sender, numbered(k, 10))
        k += 10
        time.sleep(0.01)
    recorder.kill()
    recorder.wait(10)
    sender.close()
    content, held = told(out), numbers(out)
    assert held == list(range(len(held)))
    assert 0 < content["frames"] <= len(held)
    assert len(held) > k - 200 * 10  # two seconds of it at the very most
    assert (content["state"], content["ended"]) == ("recording", None)


def test_a_signal_at_the_end_of_a_wait_does_not_stop_the_recorder_for_good() -> None:
    """A wait that a signal ends, 1,500 of them, wherever in the wait it comes."""
    waiting, began_s = _Waiting(), time.monotonic()

    def check(*_: object) -> None:
        assert time.monotonic() - began_s < 20.0, "a wait of 1 ms does not end"

    before = signal.signal(signal.SIGALRM, check)
    signal.setitimer(signal.ITIMER_REAL, 0.001, 0.00107)
    try:
        for _ in range(1_500):
            assert waiting.take(0.001) == []
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


# Several channels.


@SUFFIXES
def test_several_channels_and_interfaces_in_one_log(
    tmp_path: Path, suffix: str, udp_port: int, send_all: SendAll
) -> None:
    out = tmp_path / f"x{suffix}"
    other = "239.74.163.3"
    recorder = start_recorder(
        out, "--option", f"port={udp_port}", "--channel", GROUP, "--channel", other
    )
    ports = [
        open_port("udp_multicast", group, options={"port": udp_port, "hop_limit": 0})
        for group in (GROUP, other)
    ]
    for k in range(50):
        send_all(ports[k % 2], numbered(k, 1, can_id=0x20 + k % 2))
        time.sleep(0.002)
    time.sleep(0.3)
    recorder.send_signal(signal.SIGTERM)
    said, error = recorder.communicate(timeout=20)
    assert recorder.returncode == 0, error
    assert "recorded 50 frames" in said
    tagged = list(read_tagged_frames(out))
    names = {".log": ("can0", "can1"), ".blf": ("1", "2")}[suffix]
    by_channel = {
        name: [struct.unpack("<I", f.data)[0] for tag, f in tagged if tag.endswith(name)]
        for name in names
    }
    assert by_channel == {names[0]: list(range(0, 50, 2)), names[1]: list(range(1, 50, 2))}
    assert [f.can_id for f in replay.read_log(out, channel=names[1])] == [0x21] * 25
    with pytest.raises(InputError, match=r"holds no frame of the channel can9"):
        list(replay.read_log(out, channel="can9"))
    first, second = told(out)["channels"]
    assert (first["channel"], first["ids"]) == (GROUP, {"0x20": {"frames": 25}})
    assert (second["channel"], second["ids"]) == (other, {"0x21": {"frames": 25}})
    for port in ports:
        port.close()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--interface", "a", "--interface", "b", "--channel", "x"], "--interface: 2 of them"),
        (["--interface", "virtual", "--channel", "x", "--channel", "x"], "named twice"),
        (["--interface", "virtual", "--channel", "x", "--dbc", "no.dbc"], "no.dbc: no such file"),
    ],
)
def test_mistakes_are_one_line(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["record", str(tmp_path / "x.log"), *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_the_sidecar_knows_configuration_and_database(tmp_path: Path, udp_port: int) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(
        f"bus: {{interface: udp_multicast, channel: {GROUP}, options: {{port: {udp_port}}}}}\n"
        f"dbc: {ROOT}/dbc/eps_rig.dbc\nsignals: {ROOT}/configs/eps_rig_signals.yaml\n"
        f"model: {ROOT}/configs/reference_rig.yaml\n"
    )
    out = tmp_path / "x.log"
    words = ["record", str(out), "--config", str(config), "--duration", "0.1"]
    run = subprocess.run([sys.executable, "-m", "eps_hil.cli", *words], check=False, timeout=60)
    assert run.returncode == 0
    content = told(out)
    assert content["configuration"]["text"] == config.read_text()
    (dbc,) = content["dbc"]
    digest = subprocess.run(["sha256sum", dbc["path"]], capture_output=True, text=True, check=True)
    assert dbc["sha256"] == digest.stdout.split()[0]
    assert content["clock"][GROUP].startswith("kernel, on reception")
    assert content["versions"]["python-can"]
    assert content["host"]["name"]


# What goes wrong.


@SUFFIXES
def test_a_full_disk_is_survived(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A limit on the size of files stands in for the disk: the same refusal, from the kernel."""
    monkeypatch.setattr(record_parts, "FLUSH_S", 0.0)
    monkeypatch.setattr(record_parts, "SYNC_S", 0.0)
    said: list[str] = []
    parts = parts_of(Target(tmp_path / f"x{suffix}"), said)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    k = 0
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, before[1]))
        while not parts.full:
            parts.write(0, [replace(f, data=os.urandom(4)) for f in numbered(k, 50)])
            parts.tick()
            k += 50
            assert k < 100_000
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
        parts.write(0, numbered(k, 50))  # still full
        k += 50
        parts.tick()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    parts.tick()  # room again
    parts.write(0, numbered(k, 50))
    parts.close()
    first, *rest = parts.paths
    assert first.name == f"x{suffix}"
    held = [len(list(replay.read_log(path))) for path in parts.paths if path.stat().st_size > 144]
    assert sum(held) == parts.frames
    assert parts.frames + parts.lost == k + 50
    assert 50 <= parts.lost < 500
    assert numbers(rest[-1]) == list(range(k, k + 50))
    assert "cannot write on: File too large; it holds" in said[0]
    assert any("room again: goes on in" in line for line in said)
    lost = sum(told(path)["channels"][0]["lost_on_full_disk"] for path in parts.paths)
    assert lost == parts.lost


def test_no_new_part_before_there_is_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = parts_of(Target(tmp_path / "x.log"))
    parts._refused(OSError(28, "No space left on device"))
    parts._next_try_s = 0.0
    monkeypatch.setattr(record_parts, "ROOM_BYTES", 1 << 60)
    parts.tick()
    assert parts.full
    assert len(parts.paths) == 1


def test_frames_that_a_full_disk_kept_out_make_it_end_with_status_1(tmp_path: Path) -> None:
    source = Source([numbered(0, 10), numbered(10, 10)])
    recorder = Recorder([Channel("can0", lambda: source)], Target(tmp_path / "x.log"))
    recorder.parts._refused(OSError(28, "No space left on device"))
    recorder.parts._next_try_s = time.monotonic() + 60.0
    with pytest.raises(RecordError, match="20 frames were lost on a full or slow disk") as caught:
        recorder.run(stop=lambda: source.empty)
    assert caught.value.exit_status == 1


def test_a_lost_bus_is_opened_again_and_written_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("eps_hil.bus.reconnecting_port.PAUSE_S", 0.05)
    sources = [
        Source([numbered(0, 5), BusError("vcan0: the interface went down")]),
        Source([numbered(5, 5)]),
    ]
    waiting = list(sources)
    said: list[str] = []
    recorder = Recorder(
        [Channel("vcan0", lambda: waiting.pop(0))], Target(tmp_path / "x.log"), say=said.append
    )
    report = recorder.run(stop=lambda: sources[1].empty)
    assert (report.frames, report.outages) == (10, 1)
    assert numbers(tmp_path / "x.log") == list(range(10))
    (outage,) = told(tmp_path / "x.log")["channels"][0]["outages"]
    assert outage["reason"] == "vcan0: the interface went down"
    assert outage["from"] < outage["to"]
    assert [line.split()[1] for line in said] == ["bus", "bus"]


@pytest.mark.slow
def test_a_disk_that_stands_still_keeps_nobody_from_receiving(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """fsync takes 0.3 s; what came meanwhile was received meanwhile."""
    times: list[float] = []
    stopped = threading.Event()

    def batches() -> Iterable[list[Frame]]:
        for k in range(200):
            times.append(time.monotonic())
            yield numbered(k, 1)
            time.sleep(0.005)
        stopped.set()

    monkeypatch.setattr(record_parts, "SYNC_S", 0.2)
    monkeypatch.setattr(os, "fsync", lambda descriptor: time.sleep(0.3))
    source = Source(batches())
    recorder = Recorder([Channel("can0", lambda: source)], Target(tmp_path / "x.log"))
    report = recorder.run(stop=stopped.is_set)
    assert report.frames == 200
    assert max(b - a for a, b in itertools.pairwise(times)) < 0.2


def start_recorder(out: Path, *words: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "eps_hil.cli", "record", str(out)]
    command += ["--interface", "udp_multicast", *words]
    recorder = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert recorder.stderr is not None
    line = recorder.stderr.readline()
    assert line.startswith("recording udp_multicast"), line
    return recorder


# On a kernel with CAN.


@pytest.mark.socketcan
@SUFFIXES
def test_an_interface_that_goes_down_and_comes_back(
    brief_vcan: str, tmp_path: Path, suffix: str
) -> None:
    out = tmp_path / f"x{suffix}"

    def opener() -> Port:
        return open_port("socketcan", brief_vcan, send_ids=())

    recorder = Recorder([Channel(brief_vcan, opener)], Target(out))
    done = threading.Event()
    reports = []
    thread = threading.Thread(target=lambda: reports.append(recorder.run(stop=done.is_set)))
    thread.start()
    sender = open_port("socketcan", brief_vcan)
    for frame in numbered(0, 50):
        sender.send(frame)
    time.sleep(0.3)
    sender.close()
    subprocess.run(["ip", "link", "set", brief_vcan, "down"], check=True)
    time.sleep(0.5)
    subprocess.run(["ip", "link", "set", brief_vcan, "up"], check=True)
    time.sleep(2.5)
    sender = open_port("socketcan", brief_vcan)
    for frame in numbered(50, 50):
        sender.send(frame)
    time.sleep(0.5)
    sender.close()
    done.set()
    thread.join(10.0)
    assert numbers(out) == list(range(100))
    assert reports[0].outages == 1
    (outage,) = told(out)["channels"][0]["outages"]
    assert "down" in outage["reason"]
    assert outage["to"] is not None


@pytest.mark.slow
def test_a_recorder_that_is_held_up_for_seconds_loses_nothing(
    tmp_path: Path, udp_port: int
) -> None:
    """20,000 frames wait in the kernel, some 5 s of a 1 kHz rig; 4 MiB would keep a quarter."""
    options = {"port": udp_port, "hop_limit": 0}
    port = open_port("udp_multicast", GROUP, options=options)
    wide = open_port("udp_multicast", GROUP, options=options)
    assert isinstance(wide, SocketPort)
    if wide.widen(BUFFER_BYTES) < BUFFER_BYTES:
        pytest.skip("a large receive buffer is not permitted here (CAP_NET_ADMIN)")
    wide.close()
    out = tmp_path / "held.log"
    bus = ("--channel", GROUP)
    recorder = start_recorder(out, *bus, "--option", f"port={udp_port}")
    try:
        recorder.send_signal(signal.SIGSTOP)
        for frame in numbered(0, 20_000):
            while not port.send(frame):
                time.sleep(0.001)
        recorder.send_signal(signal.SIGCONT)
        until_s = time.monotonic() + 60.0
        while out.read_text().count("\n") < 20_000 and time.monotonic() < until_s:
            time.sleep(0.2)
    finally:
        port.close()
        recorder.send_signal(signal.SIGCONT)
        recorder.send_signal(signal.SIGTERM)
        said = recorder.communicate(timeout=60)[0]
    assert recorder.returncode == 0
    assert numbers(out) == list(range(20_000))
    assert "lost in the kernel 0" in said


@pytest.mark.slow
def test_every_thread_of_a_recorder_has_the_lowest_real_time_priority(
    tmp_path: Path, udp_port: int
) -> None:
    """Receivers alone would wait for the interpreter's lock of one that does not run."""
    bus = ("--channel", GROUP)
    recorder = start_recorder(tmp_path / "x.log", *bus, "--option", f"port={udp_port}")
    try:
        until_s, policies = time.monotonic() + 10.0, [0]
        while policies.count(os.SCHED_FIFO) < 2 and time.monotonic() < until_s:
            time.sleep(0.05)
            tasks = [int(p.name) for p in Path(f"/proc/{recorder.pid}/task").iterdir()]
            policies = [os.sched_getscheduler(one) & ~os.SCHED_RESET_ON_FORK for one in tasks]
        told = {os.sched_getparam(one).sched_priority for one in tasks}
    finally:
        recorder.send_signal(signal.SIGTERM)
        recorder.communicate(timeout=60)
    if not may_hurry():
        pytest.skip("real-time priority is not permitted here (CAP_SYS_NICE)")
    assert policies.count(os.SCHED_FIFO) == 2, "main thread and receiver"
    assert max(told) == 1


def may_hurry() -> bool:
    words = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))"
    command = [sys.executable, "-c", words]
    return subprocess.run(command, stderr=subprocess.DEVNULL, check=False).returncode == 0


@pytest.mark.socketcan
def test_two_interfaces_of_the_kernel_in_one_candump_log(
    vcan: str, brief_vcan: str, tmp_path: Path
) -> None:
    out = tmp_path / "x.log"
    ports = {name: open_port("socketcan", name) for name in (vcan, brief_vcan)}
    channels = [
        Channel(name, lambda name=name: open_port("socketcan", name, send_ids=()))  # type: ignore[misc]
        for name in ports
    ]
    recorder = Recorder(channels, Target(out))
    for k in range(20):
        name = (vcan, brief_vcan)[k % 2]
        ports[name].send(Frame(0, 0x30 + k, b""))
        time.sleep(0.001)
    recorder.run(duration_s=0.5)
    tagged = [(name, frame.can_id) for name, frame in read_tagged_frames(out)]
    assert tagged == [((vcan, brief_vcan)[k % 2], 0x30 + k) for k in range(20)]
    for port in ports.values():
        port.close()
