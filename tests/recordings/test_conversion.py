from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eps_hil.bus.frame import Frame
from eps_hil.errors import InputError
from eps_hil.recordings.can_log import read_frames, read_tagged_frames, read_unordered_frames
from eps_hil.recordings.conversion import convert, write_log
from eps_hil.recordings.read import read_recording

LogWriter = Callable[[str, list[Frame]], Path]

ROOT = Path(__file__).parents[2]
DBC = [ROOT / "dbc" / "eps_rig.dbc"]
SIGNALS = ROOT / "configs" / "eps_rig_signals.yaml"
START_NS = 1_757_617_431_821_276_000


@pytest.mark.parametrize("kind", ["csv", "parquet", "mf4"])
def test_table_of_a_log_holds_exactly_its_samples(
    tmp_path: Path, write_log: LogWriter, rig_frames: list[Frame], kind: str
) -> None:
    log = write_log("a.log", rig_frames)
    table = tmp_path / f"a.{kind}"
    convert(log, table, dbc=DBC, signals=SIGNALS)
    direct = read_recording(log, dbc=DBC, signals=SIGNALS).series
    through = read_recording(table).series
    assert set(through) == set(direct)
    for name, one in direct.items():
        np.testing.assert_array_equal(through[name].t_ns, one.t_ns)
        np.testing.assert_array_equal(through[name].value, one.value)


def test_lost_frame_is_a_hole_of_the_table(
    tmp_path: Path, write_log: LogWriter, rig_frames: list[Frame]
) -> None:
    torques = [i for i, frame in enumerate(rig_frames) if frame.can_id == 0x101]
    log = write_log("a.log", [f for i, f in enumerate(rig_frames) if i != torques[150]])
    notes = convert(log, tmp_path / "a.csv", dbc=DBC, signals=SIGNALS)
    assert "1 frames are missing, by their counter (EPS_Torques 1)" in notes
    with pytest.raises(InputError, match="column motor_torque_nm: is empty in a filled column"):
        read_recording(tmp_path / "a.csv")
    series = read_recording(tmp_path / "a.csv", gaps="mark").series
    speed, torque = series["motor_speed_rad_s"], series["motor_torque_nm"]
    assert not np.isnan(speed.value).any()
    assert np.flatnonzero(np.isnan(torque.value)).tolist() == [150]
    assert torque.t_ns[150] == speed.t_ns[150]


@pytest.mark.parametrize("chain", [("parquet", "csv"), ("mf4", "csv"), ("parquet", "mf4", "csv")])
def test_tables_convert_without_loss(tmp_path: Path, chain: tuple[str, ...]) -> None:
    source = tmp_path / "start.csv"
    source.write_text(
        "time_s,motor_torque_nm,motor_speed_rad_s,rack_force_estimate_n,valid\n"
        "1757617431.821276123,0.30000000000000004,1.0,,0\n"
        "1757617431.822276123,1e-300,,-17.25,1\n"
        "1757617431.823276123,3.0,-5e-324,2.5,1\n"
        "1757617431.824276123,4.0,,1e+22,1\n"
    )
    path = source
    for step, suffix in enumerate(chain):
        target = tmp_path / f"{step}.{suffix}"
        assert convert(path, target) == ()
        path = target
    assert path.read_text() == source.read_text()


@pytest.mark.parametrize("chain", [("blf", "log"), ("asc", "blf", "asc"), ("trc", "log")])
def test_logs_convert_into_each_other(
    tmp_path: Path, write_log: LogWriter, rig_frames: list[Frame], chain: tuple[str, ...]
) -> None:
    frames = [
        replace(frame, extended=i % 3 == 0, own=i % 2 == 0, fd=i % 5 == 0)
        for i, frame in enumerate(rig_frames)
    ]
    plain = rig_frames if "trc" in chain else frames
    path = write_log(f"start.{chain[0]}", plain)
    for step, suffix in enumerate(chain[1:]):
        target = tmp_path / f"{step}.{suffix}"
        convert(path, target)
        path = target
    shift = START_NS if "asc" in chain else 0
    expected = [replace(frame, t_ns=frame.t_ns - shift, own=False) for frame in plain]
    assert [replace(frame, own=False) for frame in read_frames(path)] == expected


def test_candump_survives_a_trip_through_blf(tmp_path: Path) -> None:
    text = (
        "(1757617431.821276) can0 123#DEADBEEF R\n"
        "(1757617431.821277) can1 00000123# T\n"
        "(1757617431.900001) can0 123##1AABB R\n"
        "(1757617432.000000) can0 123#R R\n"
    )
    (tmp_path / "a.log").write_text(text)
    convert(tmp_path / "a.log", tmp_path / "a.blf")
    convert(tmp_path / "a.blf", tmp_path / "b.log")
    assert (tmp_path / "b.log").read_text() == text


@pytest.mark.parametrize("suffix", ["blf", "asc", "mf4"])
def test_every_bus_has_its_own_number(tmp_path: Path, suffix: str) -> None:
    names = ["can_eps", "can_body", "can0", "vcan0", "can1"]
    text = "".join(f"({10 + k}.0) {name} 123#0{k} R\n" for k, name in enumerate(names * 2))
    (tmp_path / "a.log").write_text(text)
    notes = convert(tmp_path / "a.log", tmp_path / f"a.{suffix}")
    read = [channel for channel, _ in read_tagged_frames(tmp_path / f"a.{suffix}")]
    assert read == ["1", "2", "3", "4", "5"] * 2
    assert "bus channel 1: can_eps, bus channel 2: can_body, bus channel 3: can0" in notes[-1]


@pytest.mark.parametrize(
    ("suffix", "expected"), [("blf", "35"), ("asc", "35"), ("mf4", "35"), ("log", "can2 can4")]
)
@pytest.mark.parametrize("through", ["mf4", "blf"])
def test_numbers_of_buses_stay(tmp_path: Path, through: str, suffix: str, expected: str) -> None:
    (tmp_path / "a.log").write_text("(10.0) can2 123#00 R\n(11.0) can4 123#00 R\n")
    convert(tmp_path / "a.log", tmp_path / f"a.{through}")
    assert convert(tmp_path / f"a.{through}", tmp_path / f"b.{suffix}") == ()
    read = [channel for channel, _ in read_tagged_frames(tmp_path / f"b.{suffix}")]
    assert read == (expected.split() if " " in expected else list(expected))


def test_log_that_counts_from_zero_keeps_its_stamps_in_blf(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("(12.345678) can0 123#00 R\n(13.000000) can0 123#00 R\n")
    convert(tmp_path / "a.log", tmp_path / "a.blf")
    assert [frame.t_ns for frame in read_frames(tmp_path / "a.blf")] == [
        12_345_678_000,
        13_000_000_000,
    ]


@pytest.mark.parametrize(
    ("suffix", "expected"),
    [("log", [0, -1000, 1000]), ("blf", [0, -1000, 1000]), ("asc", [0, 0, 1000])],
)
def test_a_frame_before_the_first_one_stays_where_it_is(
    tmp_path: Path, suffix: str, expected: list[int]
) -> None:
    """As ``clocks --out`` writes them: a channel's frames stay in the order of the file."""
    stamps = [START_NS, START_NS - 1_000, START_NS + 1_000]
    frames = [("can0", Frame(t_ns=t_ns, can_id=1, data=b"")) for t_ns in stamps]
    write_log(tmp_path / f"a.{suffix}", frames, START_NS)
    read = [frame.t_ns for _, frame in read_unordered_frames(tmp_path / f"a.{suffix}")]
    assert [t_ns - read[0] for t_ns in read] == expected


@pytest.mark.parametrize(
    ("source", "target", "expected"),
    [
        ("a.csv", "b.xlsx", "b.xlsx: suffix '.xlsx' cannot be written; use .csv, .parquet, .mf4"),
        ("a.csv", "b.trc", "b.trc: suffix '.trc' cannot be written"),
        ("a.csv", "b.blf", "a.csv: holds columns, which cannot become CAN frames"),
        ("a.csv", "a.csv", "a.csv: is the input itself"),
        ("a.log", "b.csv", "a.log: is a CAN log, which needs --dbc and --signals"),
        ("no.csv", "b.parquet", "no.csv: no such file"),
        ("no.log", "b.blf", "no.log: no such file"),
        ("a.csv", "no/b.csv", "no does not exist"),
        ("a.log", "no/b.blf", "no does not exist"),
    ],
)
def test_what_cannot_be_converted(tmp_path: Path, source: str, target: str, expected: str) -> None:
    (tmp_path / "a.csv").write_text("time_s,rack_force_n\n0,1\n")
    (tmp_path / "a.log").write_text("(1.0) can0 123#00\n")
    with pytest.raises(InputError) as caught:
        convert(tmp_path / source, tmp_path / target)
    assert expected in str(caught.value)


def test_bad_samples_are_told_and_survive(
    tmp_path: Path, write_log: LogWriter, rig_frames: list[Frame]
) -> None:
    frames = list(rig_frames)
    position = [i for i, frame in enumerate(frames) if frame.can_id == 0x101][150]
    frames[position] = replace(frames[position], data=bytes(8))  # wrong CRC
    log = write_log("a.log", frames)
    notes = convert(log, tmp_path / "a.csv", dbc=DBC, signals=SIGNALS)
    assert notes[-1] == (
        "bad samples of motor_torque_nm, torque_sensor_nm are empty cells: "
        "read the table with --gaps mark"
    )
    direct = read_recording(log, dbc=DBC, signals=SIGNALS).series
    through = read_recording(tmp_path / "a.csv", gaps="mark").series
    for name, one in direct.items():
        np.testing.assert_array_equal(through[name].t_ns, one.t_ns)
        np.testing.assert_array_equal(through[name].value, one.value)


def test_broken_log_leaves_no_target(tmp_path: Path) -> None:
    lines = "".join(f"({i}.0) can0 123#00\n" for i in range(20))
    (tmp_path / "a.log").write_text(lines + "broken\n")
    with pytest.raises(InputError, match="line 21"):
        convert(tmp_path / "a.log", tmp_path / "a.blf")
    assert [path.name for path in tmp_path.iterdir()] == ["a.log"]


LINES = (
    "(1757617431.821276) can0 123##3AABB R\n"
    "(1757617431.821277) can0 123##2 T\n"
    "(1757617431.821278) can0 123#R8 R\n"
    "(1757617431.821279) can0 18FF0000#R3 T\n"
    "(1757617431.821280) can0 123#R R\n"
    "(1757617431.821281) can0 20000004#0004000000000000\n"
)


@pytest.mark.parametrize("through", ["log", "blf", "mf4", "asc"])
def test_remote_length_esi_and_errors_stay(tmp_path: Path, through: str) -> None:
    """ASC has no place for what an error frame says, and that is told."""
    (tmp_path / "a.log").write_text(LINES)
    notes = convert(tmp_path / "a.log", tmp_path / f"b.{through}")
    convert(tmp_path / f"b.{through}", tmp_path / "c.log")
    before = list(read_frames(tmp_path / "a.log"))
    after = list(read_frames(tmp_path / "c.log"))
    assert [frame.remote_length for frame in after] == [0, 0, 8, 3, 0, 0]
    assert [frame.remote for frame in after] == [False, False, True, True, True, False]
    assert [frame.fd for frame in after] == [True, True, False, False, False, False]
    assert [frame.esi for frame in after] == [True, True, False, False, False, False]
    error = before[-1]
    assert (after[-1].error, after[-1].t_ns - after[0].t_ns) == (True, 5000)
    told = [note for note in notes if "error frames" in note]
    if through == "asc":
        assert told == [
            "1 error frames are without their class and data, for which ASC has no place"
        ]
    else:
        assert not told
        assert (after[-1].can_id, after[-1].data) == (error.can_id, error.data)


def test_a_rate_that_no_memory_holds_is_refused(tmp_path: Path) -> None:
    source, target = tmp_path / "a.csv", tmp_path / "b.csv"
    source.write_text("time_s,motor_torque_nm\n0,1\n1000,2\n")
    with pytest.raises(InputError, match=r"--rate: 1e\+06 Hz over 1000\.0 s is 1e\+09 rows, of"):
        convert(source, target, rate_hz=1e6)
    assert not target.exists()
