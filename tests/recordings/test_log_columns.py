"""A log read at once gives what the live decoder gives frame by frame, notes included."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from asammdf import MDF, Signal, Source
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from eps_hil.bus.codec import FrameDecoder, FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.frame_columns import EXTENDED, FrameColumns
from eps_hil.bus.mapping import load_mapping
from eps_hil.bus.record import open_log
from eps_hil.errors import InputError
from eps_hil.recordings import candump_columns, log_columns, log_signals, mf4_columns
from eps_hil.recordings.can_log import read_frames
from eps_hil.recordings.frame_parts import wanted
from eps_hil.recordings.log_signals import read_log
from eps_hil.recordings.mf4_columns import Mf4Columns

ROOT = Path(__file__).parents[2]
DBC = ROOT / "dbc" / "eps_rig.dbc"
SIGNALS = ROOT / "configs" / "eps_rig_signals.yaml"
START_NS = 1_757_617_431_821_276_000
MS = 1_000_000
Read = tuple[dict[str, tuple[list[int], bytes]], tuple[str, ...]]
Fault = Callable[[list[Frame], np.random.Generator], list[Frame]]


def both(path: Path, monkeypatch: pytest.MonkeyPatch, channel: str | None = None) -> Read:
    """What the log says, once it says the same at once, in small pieces, and frame by frame."""
    answers = []
    for how in ("at once", "in pieces", "by frames"):
        with monkeypatch.context() as patch:
            if how == "by frames":
                patch.setattr(log_signals, "_columns", lambda *_: None)
            else:
                patch.setattr(log_signals, "read_frames", _not_asked)
            if how == "in pieces":
                patch.setattr(log_columns, "PIECE", 61)
                patch.setattr(candump_columns, "_CHUNK", 1 << 12)
                patch.setattr(mf4_columns, "_CHUNK", 77)
            series, notes = read_log(path, dbc=[DBC], signals=SIGNALS, channel=channel)
            signals = {
                name: (one.t_ns.tolist(), one.value.tobytes()) for name, one in series.items()
            }
            answers.append((signals, notes))
    for other in answers[1:]:
        assert list(answers[0][0]) == list(other[0])
        assert answers[0] == other
    return answers[0]


def _not_asked(*_: object, **__: object) -> None:
    raise AssertionError("it was read frame by frame")


def traffic(cycles: int, rng: np.random.Generator) -> list[Frame]:
    """Messages with counters, of a sender whose clock drifts, stamped late now and then."""
    database = load_database([DBC])
    names = ("EPS_MotorState", "EPS_Torques", "RIG_State", "EPS_SteeringWheel", "VEH_Motion")
    encoders = [FrameEncoder(database, name) for name in names]
    period = MS * (1.0 + rng.normal(0, 1e-4))
    frames = []
    for cycle in range(cycles):
        for place, encoder in enumerate(encoders):
            if place < 3 or cycle % 10 == 0:
                late = rng.exponential(20e3) + (rng.random() < 0.01) * rng.exponential(1e6)
                at = START_NS + round(cycle * period + place * 110_000 + late) // 1000 * 1000
                values = {s.name: float(rng.normal()) for s in database.get_message_by_name(
                    names[place]).signals}  # fmt: skip
                frames.append(encoder.frame(values, at))
    return sorted(frames, key=lambda frame: frame.t_ns)


def lost(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    k, n = int(rng.integers(len(frames))), int(rng.integers(1, 400))
    return frames[:k] + frames[k + n :]


def wrong_bits(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    k = int(rng.integers(len(frames)))
    data = bytearray(frames[k].data)
    data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return [*frames[:k], replace(frames[k], data=bytes(data)), *frames[k + 1 :]]


def short(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    k = int(rng.integers(len(frames)))
    return [*frames[:k], replace(frames[k], data=frames[k].data[:3]), *frames[k + 1 :]]


def repeated(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    k = int(rng.integers(len(frames)))
    return [*frames[: k + 1], *frames[k : k + int(rng.integers(1, 4))], *frames[k + 1 :]]


def late_burst(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    k, n = int(rng.integers(len(frames))), int(rng.integers(1, 60))
    until = frames[min(k + n, len(frames) - 1)].t_ns
    return frames[:k] + [replace(f, t_ns=until) for f in frames[k : k + n]] + frames[k + n :]


def clock_step(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    k, by = int(rng.integers(len(frames))), int(rng.integers(-300, 3000)) * MS
    return frames[:k] + [replace(f, t_ns=f.t_ns + by) for f in frames[k:]]


def second_sender(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    k = int(rng.integers(len(frames) - 40))
    other = [replace(f, t_ns=f.t_ns + 300_000) for f in traffic(4, rng)]
    moved = [replace(f, t_ns=f.t_ns - START_NS + frames[k].t_ns) for f in other]
    return sorted(frames + moved, key=lambda frame: frame.t_ns)


def one_message_late(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    which, by = frames[int(rng.integers(20))].can_id, int(rng.integers(1, 30)) * MS
    k = int(rng.integers(len(frames)))
    later = [replace(f, t_ns=f.t_ns + by * (f.can_id == which)) for f in frames[k:]]
    return sorted(frames[:k] + later, key=lambda frame: frame.t_ns)


def swapped(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    k = int(rng.integers(len(frames) - 5))
    return [*frames[:k], *reversed(frames[k : k + 5]), *frames[k + 5 :]]


def counter_back(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    k, by = int(rng.integers(len(frames))), int(rng.integers(1, 20))
    encoder = FrameEncoder(load_database([DBC]), "EPS_Torques")
    torques = [f for f in frames[k:] if f.can_id == 0x101 and len(f.data) == 8]
    for _ in range((torques[0].data[1] - by) % 256 if torques else 0):
        encoder.encode({})
    values = {"MotorTorque": float(rng.normal()), "TorsionBarTorque": 0.1}
    anew = {id(f): replace(f, data=encoder.encode(values)) for f in torques}
    return frames[:k] + [anew.get(id(f), f) for f in frames[k:]]


FAULTS: tuple[Fault, ...] = (
    lost, wrong_bits, short, repeated, late_burst, clock_step, second_sender, one_message_late,
    swapped, counter_back,
)  # fmt: skip


def written(path: Path, frames: list[Frame]) -> Path:
    if path.suffix in (".blf", ".mf4"):
        with can.Logger(path) as writer:
            for frame in frames:
                writer.on_message_received(as_message(frame))
        return path
    log = open_log(path, "can0", overwrite=True)
    log.write(frames)
    log.close()
    return path


@settings(
    deadline=None, max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    seed=st.integers(0, 2**32 - 1),
    which=st.lists(st.sampled_from(FAULTS), max_size=6),
    name=st.sampled_from(["bus.log", "bus.blf", "bus.mf4"]),
)  # fmt: skip
@pytest.mark.slow
def test_faulty_traffic(
    seed: int, which: list[Fault], name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(seed)
    frames = traffic(500, rng)
    for fault in which:
        frames = fault(frames, rng)
    both(written(tmp_path / name, frames), monkeypatch)


def test_every_fault_is_told_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    frames = traffic(1_500, rng)  # beyond the blocks from which the drift is taken
    # and beyond what waits for earlier stamps: so more than one piece is decoded
    for fault in FAULTS:
        frames = fault(frames, rng)
    _, notes = both(written(tmp_path / "bus.log", frames), monkeypatch)
    told = "\n".join(notes)
    for words in ("wrong CRC", "shorter", "repeat their counter", "are missing", "found anew",
                  "out of order"):  # fmt: skip
        assert words in told


@pytest.mark.slow
@settings(deadline=None, max_examples=15)
@example(seed=1, which=[repeated, second_sender, lost], length=1)
@given(
    seed=st.integers(0, 2**32 - 1),
    which=st.lists(st.sampled_from(FAULTS), max_size=6),
    length=st.sampled_from([1, 2, 7, 61, 997]),
)
def test_where_a_log_is_cut_is_not_seen(seed: int, which: list[Fault], length: int) -> None:
    rng = np.random.default_rng(seed)
    frames = traffic(400, rng)
    for fault in which:
        frames = fault(frames, rng)
    frames.sort(key=lambda frame: frame.t_ns)
    widest = max(len(frame.data) for frame in frames)
    whole = FrameColumns(
        np.array([frame.t_ns for frame in frames]),
        np.array([frame.can_id for frame in frames]),
        np.array([len(frame.data) for frame in frames]),
        np.array([[*frame.data.ljust(widest, b"\0")] for frame in frames], np.uint8),
    )
    ends = [*range(0, len(frames), length), len(frames)]
    answers = []
    for edges in ([0, len(frames)], ends):
        decoder = FrameDecoder(load_database([DBC]), load_mapping(SIGNALS)).columns()
        assert decoder is not None
        for first, last in pairwise(edges):
            part = slice(first, last)
            assert decoder.add(
                FrameColumns(
                    whole.t_ns[part], whole.key[part], whole.length[part], whole.data[part]
                )
            )
        found = decoder.result()
        samples = {n: (t.tolist(), v.tobytes()) for n, (t, v) in found.samples.items()}
        answers.append((list(samples), samples, found.faults, list(found.faults)))
    assert answers[0] == answers[1]


def test_a_long_log_is_held_a_piece_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path / "bus.log", traffic(3_000, np.random.default_rng(2)))
    monkeypatch.setattr(log_columns, "PIECE", 500)
    monkeypatch.setattr(candump_columns, "_CHUNK", 1 << 12)
    sizes: list[int] = []
    for piece in log_columns.pieces_of(path, ids=[0x100, 0x101, 0x110], notes=[]):
        assert piece is not None
        sizes.append(len(piece.key))
    assert sum(sizes) > 8_000
    assert max(sizes) < 2_000


def as_message(frame: Frame, **more: Any) -> can.Message:
    known = {"channel": 0, "is_fd": frame.fd, "is_extended_id": frame.extended}
    return can.Message(
        timestamp=frame.t_ns / 1e9, arbitration_id=frame.can_id, data=frame.data, **known | more
    )


def lines(frames: list[Frame], rest: str = "") -> list[str]:
    return [
        f"({f.t_ns // 10**9}.{f.t_ns % 10**9:09d}) can0 {f.can_id:03X}#{f.data.hex().upper()}{rest}"
        for f in frames
    ]


def test_what_else_stands_in_a_log(
    rig_frames: list[Frame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Blank lines, errors, requests, CAN FD, other buses, other widths, and a last line cut off."""
    plain = lines(rig_frames)
    plain[3] = plain[3].lower().replace("can0", " can0") + "  T\r"
    plain[5] = plain[5].replace("#", "##1") + "00" * 8  # padded as CAN FD does
    plain[10:10] = ["", "   ", "(1757617431.9) can0 20000004#0000000000000000"]
    plain[20:20] = ["(1757617431.83) can0 123#R", "(1757617431.83) can1 123##0AABB"]
    plain[30:30] = ["(1757617431.83) can1 00000100#DEADBEEF"]  # another id: it has 29 bits
    path = tmp_path / "bus.log"
    path.write_text("\n".join([*plain, plain[0][:30]]))
    _, notes = both(path, monkeypatch)
    assert f"line {len(plain) + 1} is cut off: left out" in notes
    path.write_text("\n".join(plain))
    assert not any("cut off" in note for note in both(path, monkeypatch)[1])


def test_one_of_two_buses(
    rig_frames: list[Frame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "bus.log"
    first = lines(rig_frames)
    path.write_text("\n".join(first + [line.replace("can0", "can1") for line in first[:-9]]))
    all_of_it, _ = both(path, monkeypatch, "can0")
    fewer, _ = both(path, monkeypatch, "can1")
    assert len(fewer["motor_speed_rad_s"][0]) < len(all_of_it["motor_speed_rad_s"][0])


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("(1757617431.9) can0 100#DEADBEEFX", "line 41: '(1757617431.9) can0 100#DEADBEEFX'"),
        ("(1757617430.9) can0 100#DEADBEEF", "line 41: time goes back"),
        ("(1757617431.9) can1 100#DEADBEEF", "on channel can0 and on can1"),
        ("\x00" * 30, "line 41"),
        ("(1757617431.9) can0 100#" + "0" * 500, "line 41"),
    ],
)
def test_what_is_refused_names_its_line(
    rig_frames: list[Frame], tmp_path: Path, line: str, said: str
) -> None:
    path = tmp_path / "bus.log"
    text = lines(rig_frames)
    path.write_text("\n".join([*text[:40], line, *text[40:], ""]))
    with pytest.raises(InputError) as refused:
        read_log(path, dbc=[DBC], signals=SIGNALS)
    assert said in str(refused.value)


def test_progress_is_told(rig_frames: list[Frame], tmp_path: Path) -> None:
    path = written(tmp_path / "bus.log", rig_frames)
    heard: list[float] = []
    read_log(path, dbc=[DBC], signals=SIGNALS, on_progress=heard.append)
    assert heard == sorted(heard)
    assert heard[-1] == 1.0


def test_what_else_stands_in_a_blf(
    rig_frames: list[Frame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors, requests, CAN FD, other channels, ids of 29 bits, more than one container."""
    path = tmp_path / "bus.blf"
    with can.Logger(path, max_container_size=9_999) as writer:
        for k, frame in enumerate(rig_frames):
            writer.on_message_received(as_message(frame))
            if k % 50 == 0:
                for more in ({"is_error_frame": True}, {"channel": 3}, {"is_extended_id": True}):
                    writer.on_message_received(
                        as_message(replace(frame, can_id=0x321), **more)
                    )  # fmt: skip
                writer.on_message_received(
                    can.Message(timestamp=frame.t_ns / 1e9, arbitration_id=0x100, channel=0,
                                is_remote_frame=True, dlc=8, is_extended_id=False)
                )  # fmt: skip
    signals, _ = both(path, monkeypatch)
    assert len(signals["motor_speed_rad_s"][0]) == 300
    both(path, monkeypatch, "1")


def test_a_blf_with_can_fd(
    rig_frames: list[Frame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fd = [replace(f, fd=True, data=f.data + bytes(4) if k % 3 else f.data)
          for k, f in enumerate(rig_frames)]  # fmt: skip
    both(written(tmp_path / "bus.blf", fd), monkeypatch)


def as_signal(frames: list[Frame], channels: list[int]) -> Signal:
    """CAN frames as asammdf has them, stamps since 1970."""
    name = "CAN_DataFrame"
    kinds = [(f"{name}.{part}", kind) for part, kind in (
        ("BusChannel", "<u1"), ("ID", "<u4"), ("IDE", "<u1"), ("DLC", "<u1"),
        ("DataLength", "<u1"), ("DataBytes", "(64,)u1"), ("EDL", "<u1"))]  # fmt: skip
    samples = np.zeros(len(frames), np.dtype(kinds))
    for row, (frame, channel) in enumerate(zip(frames, channels, strict=True)):
        padded = np.frombuffer(frame.data.ljust(64, b"\xff"), np.uint8)
        samples[row] = (
            channel, frame.can_id, frame.extended, len(frame.data), len(frame.data), padded, 0
        )  # fmt: skip
    stamps_s = np.array([frame.t_ns / 1e9 for frame in frames])
    bus = Source("CAN", "CAN", "", Source.SOURCE_BUS, Source.BUS_TYPE_CAN)
    return Signal(samples, stamps_s, name=name, source=bus)


def test_groups_of_an_mf4(
    rig_frames: list[Frame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each channel has its group, or groups share a channel; bytes behind a payload are nothing."""
    path = tmp_path / "bus.mf4"
    other = [replace(f, can_id=0x321) for f in rig_frames]
    for groups in (
        [(rig_frames, [1] * len(rig_frames)), (other, [2] * len(other))],
        [(rig_frames[::2], [1] * len(rig_frames[::2])),
         (rig_frames[1::2], [1] * len(rig_frames[1::2]))],
        [(rig_frames, [1 if f.can_id == rig_frames[0].can_id else 7 for f in rig_frames])],
    ):  # fmt: skip
        with MDF(version="4.10") as mdf:
            mdf.header.abs_time = 0
            for frames, channels in groups:
                mdf.append([as_signal(frames, channels)], common_timebase=True)
                group: Any = mdf.groups[-1].channel_group
                group.flags |= 1 << 1  # frames of a bus
            mdf.save(path, overwrite=True)
        signals, _ = both(path, monkeypatch)
        assert len(signals["motor_speed_rad_s"][0]) == 300
    short, _ = both(path, monkeypatch, "7")
    assert "motor_speed_rad_s" not in short


def test_groups_of_an_mf4_that_go_back_in_time_are_read_by_frames(
    rig_frames: list[Frame], tmp_path: Path
) -> None:
    path = tmp_path / "bus.mf4"
    moved = rig_frames[:10] + rig_frames[12:13] + rig_frames[10:12] + rig_frames[13:]
    with MDF(version="4.10") as mdf:
        for frames in (moved, [replace(f, can_id=0x321) for f in rig_frames]):
            mdf.append([as_signal(frames, [1] * len(frames))], common_timebase=True)
            group: Any = mdf.groups[-1].channel_group
            group.flags |= 1 << 1
        mdf.save(path, overwrite=True)
    keep = wanted([rig_frames[0].can_id], None)
    assert next(Mf4Columns(path, keep=keep).parts(None)) is None


def test_a_blf_without_its_end_is_read_by_frames(rig_frames: list[Frame], tmp_path: Path) -> None:
    path = tmp_path / "bus.blf"
    with can.Logger(path, max_container_size=9_999) as writer:
        for frame in rig_frames:
            writer.on_message_received(as_message(frame))
    path.write_bytes(path.read_bytes()[:-300])
    series, _ = read_log(path, dbc=[DBC], signals=SIGNALS)
    assert 100 < len(series["motor_speed_rad_s"].t_ns) < 300


@pytest.mark.parametrize("bit", [0, 0x8000_0000])
def test_an_mf4_without_ide_says_it_by_the_id(
    rig_frames: list[Frame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bit: int
) -> None:
    """Bit 31, as asammdf reads it, or an id beyond 11 bits; by columns and by frames alike."""
    path = tmp_path / "bus.mf4"
    wide = [replace(f, can_id=0x18FF0000 | bit) for f in rig_frames[1::3]]
    told = [replace(f, can_id=0x7FF | bit) for f in rig_frames[2::3]]
    signal = as_signal([*rig_frames[::3], *wide, *told], [1] * len(rig_frames))
    order = np.argsort(signal.timestamps, kind="stable")
    names = [name for name in signal.samples.dtype.names if not name.endswith("IDE")]
    rows = np.zeros(len(order), [(name, signal.samples.dtype[name]) for name in names])
    for name in names:
        rows[name] = signal.samples[name][order]
    with MDF(version="4.10") as mdf:
        mdf.header.abs_time = 0
        mdf.append([Signal(rows, signal.timestamps[order], name=signal.name, source=signal.source)])
        group: Any = mdf.groups[-1].channel_group
        group.flags |= 1 << 1
        mdf.save(path, overwrite=True)
    formats = {rig_frames[0].can_id: False, 0x18FF0000: True, 0x7FF: bit != 0}
    found = {(frame.can_id, frame.extended) for frame in read_frames(path)}
    assert found >= set(formats.items())
    assert len({can_id for can_id, _ in found}) == len(found)
    keep = wanted(list(formats), None)
    keys = {int(key) for parts in Mf4Columns(path, keep=keep).parts(None)
            for part in parts or () for key in part.key}  # fmt: skip
    assert keys == {can_id | EXTENDED * is_extended for can_id, is_extended in formats.items()}
