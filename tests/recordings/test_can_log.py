import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.errors import InputError
from eps_hil.recordings.can_log import read_frames
from eps_hil.recordings.read import read_recording

LogWriter = Callable[[str, list[Frame]], Path]

ROOT = Path(__file__).parents[2]
DBC = [ROOT / "dbc" / "eps_rig.dbc"]
SIGNALS = ROOT / "configs" / "eps_rig_signals.yaml"
START_NS = 1_757_617_431_821_276_000
FORMATS = ("log", "blf", "asc", "trc")


def _candump(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "a.log"
    path.write_text(text)
    return path


def _refused(path: Path, **options: object) -> str:
    with pytest.raises(InputError) as caught:
        list(read_frames(path, **options))  # type: ignore[arg-type]
    return str(caught.value)


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_gives_the_same_frames(
    write_log: LogWriter, rig_frames: list[Frame], kind: str
) -> None:
    frames = list(read_frames(write_log(f"a.{kind}", rig_frames)))
    start_ns = START_NS if kind == "asc" else 0  # ASC counts from its first frame
    assert frames == [replace(frame, t_ns=frame.t_ns - start_ns) for frame in rig_frames]


def test_mf4_bus_logging_gives_the_same_frames(
    write_log: LogWriter, rig_frames: list[Frame]
) -> None:
    now_ns = 4_000_000_000 * 10**9  # python-can's writer wants stamps after its own start
    later = [replace(f, t_ns=f.t_ns - START_NS + now_ns) for f in rig_frames[:60]]
    frames = list(read_frames(write_log("a.mf4", later)))
    assert [replace(f, t_ns=0) for f in frames] == [replace(f, t_ns=0) for f in later]
    # the writer keeps floats of seconds after its own start: the last microsecond is lost there
    assert max(abs(a.t_ns - b.t_ns) for a, b in zip(frames, later, strict=True)) <= 1000


@pytest.mark.parametrize("kind", FORMATS)
def test_signals_are_the_same_from_every_format(
    write_log: LogWriter, rig_frames: list[Frame], kind: str
) -> None:
    path = write_log(f"a.{kind}", rig_frames)
    recording = read_recording(path, dbc=DBC, signals=SIGNALS)
    speed = recording.series["motor_speed_rad_s"]
    cycle = np.arange(300)
    np.testing.assert_allclose(speed.value, 20 * np.sin(0.02 * cycle), atol=0.6e-4)
    offset = 0 if kind == "asc" else START_NS
    np.testing.assert_allclose(speed.t_ns - offset, cycle * 1_000_000, atol=2_000)
    assert len(recording.series["steering_wheel_angle_rad"].t_ns) == 30
    assert len(recording.series["rack_force_n"].t_ns) == 300
    assert any("never occur: motor_temperature_degc" in note for note in recording.notes)


def test_candump_line_by_line(tmp_path: Path) -> None:
    path = _candump(
        tmp_path,
        "(1757617431.821276) can0 123#DEADBEEF\n"
        "\n"
        "(1757617431.821276123) can0 00000123#  R\n"
        "(1757617431.9) can0 123##1AABB T\r\n"
        "(1757617432.0) can0 123#R8\n"
        "(1757617432.1) can0 20000080#0000000000000000\n"
        "(1757617432.2) can0 7ff#0102030405060708_9\n",
    )
    second = 1_757_617_431_000_000_000
    assert list(read_frames(path)) == [
        Frame(second + 821_276_000, 0x123, b"\xde\xad\xbe\xef"),
        Frame(second + 821_276_123, 0x123, b"", extended=True),
        Frame(second + 900_000_000, 0x123, b"\xaa\xbb", fd=True, brs=True, own=True),
        Frame(second + 1_000_000_000, 0x123, b"", remote=True, remote_length=8),
        Frame(second + 1_100_000_000, 0x80, bytes(8), extended=True, error=True),
        Frame(second + 1_200_000_000, 0x7FF, bytes(range(1, 9))),
    ]


@pytest.mark.parametrize(
    "line",
    [
        "hello",
        "(1.0) can0 123",
        "(1.0) can0 12#00",
        "(1.0) can0 123#0",
        "(1.0) can0 123#000102030405060708",
        "(x.0) can0 123#00",
        "1.0 can0 123#00",
        "(1.0) 123#00",
    ],
)
def test_bad_candump_line_is_named(tmp_path: Path, line: str) -> None:
    text = f"(1.0) can0 123#00\n{line}\n(2.0) can0 123#00\n"
    assert "a.log: line 2: " in _refused(_candump(tmp_path, text))


TRC_HEAD = ";$FILEVERSION={}\n;$STARTTIME=45917.79\n"
TRC_COLUMNS = ";$COLUMNS=N,O,T,I,d,{},D\n"
ASC_HEAD = "date Thu Sep 11 19:03:51.821 2025\nbase hex  timestamps absolute\n"
SHORT = [
    ("a.trc", TRC_HEAD.format("1.1"), "{}) {}.0 Rx 0123 8 {}"),
    ("a.trc", "", "{}) {}.0 0123 8 {}"),
    ("a.trc", TRC_HEAD.format("1.3"), "{}) {}.0 1 Rx 0123 - 8 {}"),
    ("a.trc", TRC_HEAD.format("2.1") + TRC_COLUMNS.format("L"), "{} {}.0 DT 0123 Rx 8 {}"),
    ("a.trc", TRC_HEAD.format("2.1") + TRC_COLUMNS.format("l"), "{} {}.0 FD 0123 Rx 12 {}"),
    ("a.asc", ASC_HEAD, "{}.{} 1 123 Rx d 8 {}"),
]


@pytest.mark.parametrize(("name", "head", "line"), SHORT, ids=lambda one: one[:25])
def test_a_frame_with_fewer_bytes_than_it_says_is_no_data(
    tmp_path: Path, name: str, head: str, line: str
) -> None:
    path, whole = tmp_path / name, " ".join(["01"] * (12 if "FD" in line else 8))
    notes: list[str] = []
    lines = [line.format(1, 1, whole), line.format(2, 2, "01 02"), line.format(3, 3, whole)]
    path.write_text(head + "\n".join(lines) + "\n")
    place = f"{name}: line {head.count(chr(10)) + 2}: a frame has fewer bytes than its length says"
    assert place in _refused(path)
    path.write_text(head + "\n".join(lines[:2]))  # the logger was stopped amid a frame
    frames = list(read_frames(path, notes=notes))
    assert [frame.data for frame in frames] == [bytes.fromhex(whole)]
    assert notes == ["the file is damaged or cut off after 1 frames"]
    path.write_text(head + "\n".join([lines[0], lines[2]]) + "\n")
    assert len(list(read_frames(path))) == 2


def test_log_that_was_cut_off_is_read_up_to_there(tmp_path: Path) -> None:
    notes: list[str] = []
    path = _candump(tmp_path, "(1.0) can0 123#00\n(2.0) can0 12")
    assert len(list(read_frames(path, notes=notes))) == 1
    assert notes == ["line 2 is cut off: left out"]


def test_bad_asc_line_is_named(write_log: LogWriter, rig_frames: list[Frame]) -> None:
    path = write_log("a.asc", rig_frames[:20])
    lines = path.read_text().splitlines()
    lines[9] = lines[9][:-2] + "XY"
    path.write_text("\n".join(lines))
    assert "a.asc: after line 10: is not readable as ASC (ValueError)" in _refused(path)


def test_asc_with_relative_stamps_is_refused(write_log: LogWriter, rig_frames: list[Frame]) -> None:
    path = write_log("a.asc", rig_frames[:20])
    path.write_text(path.read_text().replace("timestamps absolute", "timestamps relative"))
    assert "relative to the event before; export with absolute" in _refused(path)


_BODY = (
    "Begin Triggerblock Tue Mar 5 10:00:00.000 am 2024\n"
    "   0.000000 Start of measurement\n"
    "   0.001000 1  291             Rx   d 2 10 11\n"
    "   0.002000 1  292             Rx   d 2 12 13\n"
)


@pytest.mark.parametrize(
    "date",
    [
        "date Tue Mar 5 10:00:00.000 am 2024",
        "date 05.03.2024 10:00:00",
        "date 2024-03-05T10:00:00",
        "date Di. Mär 5 10:00:00.000 2024",
        "\ufeffdate Tue Mar 5 10:00:00.000 am 2024",
        "// exported",
    ],
)
@pytest.mark.parametrize("events", ["internal events logged\n", ""])
def test_asc_head_of_any_tool_is_understood(tmp_path: Path, date: str, events: str) -> None:
    path = tmp_path / "a.asc"
    path.write_text(f"{date}\nbase dec  timestamps absolute\n{events}{_BODY}", encoding="utf-8")
    assert list(read_frames(path)) == [
        Frame(1_000_000, 291, bytes([10, 11])),
        Frame(2_000_000, 292, bytes([12, 13])),
    ]
    path.write_text(f"{date}\nbase hex  timestamps relative\n{events}{_BODY}", encoding="utf-8")
    assert "a.asc: line 2: time stamps are relative to the event before" in _refused(path)
    path.write_text(f"{date}\n{events}{_BODY}", encoding="utf-8")
    assert "no line 'base hex' or 'base dec' stands before the first event" in _refused(path)


def test_asc_without_the_line_of_internal_events_keeps_its_first_frame(tmp_path: Path) -> None:
    path = tmp_path / "a.asc"
    frames = "".join(_BODY.splitlines(keepends=True)[2:])
    path.write_text(f"base hex  timestamps absolute\n{frames}")
    assert [frame.can_id for frame in read_frames(path)] == [0x291, 0x292]


def test_asc_requests_to_send_are_no_frames(tmp_path: Path) -> None:
    path, notes = tmp_path / "a.asc", list[str]()
    path.write_text(
        "base hex  timestamps absolute\n"
        "   0.001000 1  123             TxRq   d 2 10 11\n"
        "   0.001250 1  123             Tx   d 2 10 11\n"
        "   0.002000 CANFD   1 TxRq   124  0 0 2 2 10 11\n"
        "   0.002250 CANFD   1 Tx   124  0 0 2 2 10 11\n"
    )
    frames = list(read_frames(path, notes=notes))
    assert [(frame.t_ns, frame.own) for frame in frames] == [(1_250_000, True), (2_250_000, True)]
    assert notes == ["2 requests to send (TxRq) are left out"]


def test_asc_with_names_of_messages_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.asc"
    head = "base hex  timestamps absolute\n   0.001000 1  123             Rx   d 1 10\n"
    for line in ("1  EngineData      Rx   d 1 10", "CANFD   1 Rx   EngineData  0 0 1 1 10"):
        path.write_text(f"{head}   0.002000 {line}\n   0.003000 {line}\n")
        assert "a.asc: line 3: has a message's name in place of an id" in _refused(path)


def test_slight_disorder_is_sorted_and_told(tmp_path: Path) -> None:
    notes: list[str] = []
    path = _candump(tmp_path, "(1.0) a 1F0#\n(1.2) a 1F1#\n(1.1) b 1F2#\n(1.3) a 1F3#\n")
    ids = [frame.can_id for frame in read_frames(path, notes=notes)]
    assert ids == [0x1F0, 0x1F2, 0x1F1, 0x1F3]
    assert notes == ["1 frames were out of order: sorted by stamp"]


def test_time_that_jumps_back_is_refused(tmp_path: Path) -> None:
    path = _candump(tmp_path, "(5.0) a 1F0#\n(9.0) a 1F1#\n(5.1) a 1F2#\n")
    assert "a.log: line 3: time goes back by 3.9 s; split the log there" in _refused(path)


def test_buses_are_told_apart(tmp_path: Path) -> None:
    path = _candump(tmp_path, "(1.0) can0 100#\n(1.1) can1 101#\n(1.2) can1 100#\n")
    assert len(list(read_frames(path))) == 3
    assert len(list(read_frames(path, channel="can1"))) == 2
    assert len(list(read_frames(path, ids=[0x101]))) == 1
    assert "id 0x100 is on channel can0 and on can1; choose one with --channel" in _refused(
        path, ids=[0x100]
    )
    assert len(list(read_frames(path, ids=[0x100], channel="can1"))) == 1
    assert "channel can7: does not occur; the log has: can0, can1" in _refused(path, channel="can7")


def test_vendor_channels_count_from_one(tmp_path: Path, rig_frames: list[Frame]) -> None:
    path = tmp_path / "a.blf"
    with can.Logger(path) as log:
        for number in (0, 1):
            log.on_message_received(can.Message(timestamp=1e9 + number, channel=number))
    assert [f.t_ns for f in read_frames(path, channel="2")] == [1_000_000_001 * 10**9]


def test_log_needs_database_and_mapping(tmp_path: Path) -> None:
    path = _candump(tmp_path, "(1.0) can0 7E0#00\n")
    for options, missing in (
        ({}, "needs --dbc and --signals;"),
        ({"dbc": DBC}, "needs --signals;"),
        ({"signals": SIGNALS}, "needs --dbc;"),
    ):
        with pytest.raises(InputError) as caught:
            read_recording(path, **options)
        assert missing in str(caught.value)
    with pytest.raises(InputError, match=r"a\.log: no mapped frame occurs \(ids 0x100, 0x101"):
        read_recording(path, dbc=DBC, signals=SIGNALS)


def test_frames_with_a_wrong_crc_become_bad_samples(
    write_log: LogWriter, rig_frames: list[Frame]
) -> None:
    frames = list(rig_frames)
    position = next(i for i, f in enumerate(frames) if i > 100 and f.can_id == 0x101)
    frames[position] = replace(frames[position], data=bytes(8))
    recording = read_recording(write_log("a.log", frames), dbc=DBC, signals=SIGNALS)
    assert np.isnan(recording.series["motor_torque_nm"].value).sum() == 1
    assert not np.isnan(recording.series["motor_speed_rad_s"].value).any()
    assert "1 frames with a wrong CRC: marked bad (EPS_Torques 1)" in recording.notes
    assert "motor_torque_nm: 1 of 300 samples are marked bad" in recording.notes


def test_what_a_service_published_gets_one_note(
    write_log: LogWriter, rig_frames: list[Frame]
) -> None:
    """Its own frames are no input: whatever is wrong with them is one line."""
    estimate = load_database(DBC).get_message_by_name("EPSHIL_Estimate")
    frames: list[Frame] = []
    for frame in rig_frames:
        frames.append(frame)
        if frame.can_id == 0x100:
            values = {one.name: 0 for one in estimate.signals} | {"Crc": 1}
            data = estimate.encode(values, scaling=False, strict=False)
            data = data if len(frames) > 20 else data[:-1]
            frames.append(replace(frame, can_id=estimate.frame_id, data=data))
    recording = read_recording(write_log("a.log", frames), dbc=DBC, signals=SIGNALS)
    told = [note for note in recording.notes if "EPSHIL_Estimate" in note]
    assert len(told) == 1
    assert told[0].startswith("EPSHIL_Estimate, published by a service: ")
    assert "frames with a wrong CRC, " in told[0]
    assert told[0].endswith("frames shorter than the DBC says")
    assert not any(note.startswith("rack_force_estimate_n: ") for note in recording.notes)


def test_progress_ends_at_one(write_log: LogWriter, rig_frames: list[Frame]) -> None:
    for kind in FORMATS:
        heard: list[float] = []
        list(read_frames(write_log(f"a.{kind}", rig_frames * 5), on_progress=heard.append))
        assert heard == sorted(heard)
        assert heard[-1] == 1.0
        assert all(0 <= fraction <= 1 for fraction in heard)


@settings(max_examples=60, deadline=None)
@given(cut=st.floats(0.0, 0.999), kind=st.sampled_from(FORMATS))
def test_truncated_log_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, rig_frames: list[Frame], cut: float, kind: str
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    whole, part = folder / f"whole.{kind}", folder / f"part.{kind}"
    with can.Logger(whole) as log:
        for frame in rig_frames[:40]:
            log.on_message_received(
                can.Message(
                    timestamp=frame.t_ns / 1e9,
                    arbitration_id=frame.can_id,
                    is_extended_id=False,
                    data=frame.data,
                )
            )
    content = whole.read_bytes()
    part.write_bytes(content[: int(cut * len(content))])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            count = len(list(read_frames(part)))
        except InputError:
            return
    assert 0 < count <= 40


@settings(max_examples=60, deadline=None)
@given(
    changes=st.lists(st.tuples(st.floats(0, 0.999), st.integers(0, 255)), min_size=1, max_size=4),
    kind=st.sampled_from(FORMATS),
)
def test_damaged_log_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory,
    rig_frames: list[Frame],
    changes: list[tuple[float, int]],
    kind: str,
) -> None:
    path = tmp_path_factory.mktemp("damaged") / f"a.{kind}"
    with can.Logger(path) as log:
        for frame in rig_frames[:20]:
            log.on_message_received(can.Message(timestamp=frame.t_ns / 1e9, data=frame.data))
    content = bytearray(path.read_bytes())
    for where, byte in changes:
        content[int(where * len(content))] = byte
    path.write_bytes(bytes(content))
    try:
        count = len(list(read_frames(path)))
    except InputError:
        return
    assert 0 < count <= 21
