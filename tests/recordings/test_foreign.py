"""Tables as simulation tools write them."""

import re
from pathlib import Path

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.recordings.foreign import load_columns, read_foreign
from eps_hil.recordings.read import read_recording

MAPPING = """
time: {column: t, scale: 0.001}
signals:
  motor_speed_rad_s: {column: n_rotor, scale: 0.10471975511965977}
  motor_torque_nm: {column: M_mot, offset: 0.5}
"""


def mapping(folder: Path) -> Path:
    path = folder / "columns.yaml"
    path.write_text(MAPPING, encoding="utf-8")
    return path


def test_names_units_semicolons_and_events(tmp_path: Path) -> None:
    path = tmp_path / "sim.csv"
    path.write_text(
        "t;n_rotor;M_mot;other\n[ms];[rpm];[Nm];[-]\n"
        "0;0;1,5;7\n10;60;1,25;7\n10;90;1,0;7\n20;120;0,75;7\n",
        encoding="utf-8",
    )
    one = read_foreign(path, load_columns(mapping(tmp_path)))
    assert set(one.series) == {"motor_speed_rad_s", "motor_torque_nm"}
    speed = one.series["motor_speed_rad_s"]
    assert speed.t_ns.tolist() == [0, 10_000_000, 20_000_000]
    assert speed.value == pytest.approx([0.0, 3 * np.pi, 4 * np.pi])
    assert one.series["motor_torque_nm"].value == pytest.approx([2.0, 1.5, 1.25])
    assert one.notes == ("columns left out: other",)


def test_canonical_names_need_no_mapping(tmp_path: Path) -> None:
    path = tmp_path / "sim.csv"
    path.write_text("time_s,motor_speed_rad_s,x\n0,1,2\n0.1,2,3\n", encoding="utf-8")
    assert set(read_foreign(path).series) == {"motor_speed_rad_s"}


def test_a_parquet_table(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    path = tmp_path / "sim.parquet"
    table = {"t": [0.0, 1.0, 2.0], "n_rotor": [0.0, 60.0, 60.0], "M_mot": [0, 1, 2]}
    parquet.write_table(pyarrow.table(table), path)
    one = read_foreign(path, load_columns(mapping(tmp_path)))
    assert one.series["motor_torque_nm"].value == pytest.approx([0.5, 1.5, 2.5])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "empty"),
        ("time_s,a\n0,1\n1,2\n", "no column with a canonical name"),
        ("t,n_rotor\nnothing,here\n", "no line of numbers"),
    ],
)
def test_what_is_no_trace_is_said(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "sim.csv"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_foreign(path)


def test_a_missing_column_is_named(tmp_path: Path) -> None:
    path = tmp_path / "sim.csv"
    path.write_text("t,M_mot\n0,1\n1,2\n", encoding="utf-8")
    with pytest.raises(InputError, match="n_rotor"):
        read_foreign(path, load_columns(mapping(tmp_path)))


def test_a_wrong_mapping_is_named(tmp_path: Path) -> None:
    path = tmp_path / "columns.yaml"
    path.write_text("signals: {rotor_speed: {column: a}}", encoding="utf-8")
    with pytest.raises(InputError, match="canonical"):
        load_columns(path)


TABLE = """
time: {column: ms, scale: 0.001}
signals:
  rack_force_n: {sum: [left, right]}
  motor_torque_nm: {column: iq, torque_constant_nm_per_a: 0.05}
  motor_angle_rad: {column: counts, counts_per_turn: 4096}
"""


def test_a_recordings_columns_are_mapped_as_a_can_logs_signals_are(tmp_path: Path) -> None:
    """Renamed, summed, a torque from a current, an angle from counts that begin anew."""
    path, columns = tmp_path / "rig.csv", tmp_path / "columns.yaml"
    rows = [(0, 10.0, 5.0, 2.0, 4000), (10, 11.0, 5.5, 4.0, 4095), (20, 12.0, 6.0, 0.0, 94)]
    body = "\n".join(",".join(map(str, row)) for row in rows)
    path.write_text(f"ms,left,right,iq,counts\n{body}\n", encoding="utf-8")
    columns.write_text(TABLE, encoding="utf-8")
    read = read_recording(path, signals=columns).series
    assert read["rack_force_n"].t_ns.tolist() == [0, 10_000_000, 20_000_000]
    assert read["rack_force_n"].value == pytest.approx([15.0, 16.5, 18.0])
    assert read["motor_torque_nm"].value == pytest.approx([0.1, 0.2, 0.0])
    turns = np.array([4000, 4095, 4190]) / 4096
    assert read["motor_angle_rad"].value == pytest.approx(2 * np.pi * turns)


@pytest.mark.parametrize(
    ("content", "entry", "said"),
    [
        ("t,a\n0,1\n0,2\n", "{column: a}", "line 3, column t: time repeats"),
        ("t,a\n0,1\n1,2\n", "{column: b}", "column 'b': is missing; there are: t, a"),
        ("t,a\n0,1\n1,2\n", "{scale: 2.0}", "column 'rack_force_n': is missing"),
        ("t,a\n0,1\n1,2\n", "{column: a, sum: [a]}", "not both"),
        ("t,a\n0,1\n1,2\n", "{sum: [a], counts_per_turn: 1}", "greater than 1"),
    ],
)
def test_a_mapped_recording_is_held_to_as_much_as_any(
    tmp_path: Path, content: str, entry: str, said: str
) -> None:
    path, columns = tmp_path / "rig.csv", tmp_path / "columns.yaml"
    path.write_text(content, encoding="utf-8")
    signals = f"  rack_force_n: {entry}\n  motor_torque_nm: {{sum: [a]}}\n"
    columns.write_text(f"time: {{column: t}}\nsignals:\n{signals}", encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(said)):
        read_recording(path, signals=columns)


def test_a_dbcs_mapping_leaves_tables_as_they_are(tmp_path: Path) -> None:
    """Logs and tables may be given together."""
    path = tmp_path / "rig.csv"
    path.write_text("time_s,rack_force_n\n0,1\n0.1,2\n", encoding="utf-8")
    mapping = Path(__file__).parents[2] / "configs" / "eps_rig_signals.yaml"
    assert set(read_recording(path, signals=mapping).series) == {"rack_force_n"}


CANONICAL = "time_s,motor_torque_nm,torque_sensor_nm\n0,1,2\n0.1,2,3\n0.2,3,4\n"


@pytest.mark.parametrize(
    ("mapping", "said"),
    [
        ("signals: {motor_torque_nm: torque_sensor_nm}", "signals.motor_torque_nm: needs fields"),
        ("signals: {motor_torque_nm: {Column: torque_sensor_nm}}", "Column: is not a known field"),
        ("signals: {motor_torque_nm: {colum: torque_sensor_nm}}", "colum: is not a known field"),
        ("signals: {motor_torque_nm: {column: ''}}", "at least 1 character"),
        ("signals: {motor_torque_nm: {sum: []}}", "at least 1 item"),
        ("time: {column: time_s, scale: 0.001}", "signals: is missing"),
        ("signals: {}\ntime: {scale: 0.001}", "at least 1 item"),
        ("hello: 1", "signals: is missing"),
        ("- a list", "dictionary"),
        ("signals: {motor_torque_nm: {message: M, signal: S, colum: x}}", "colum: is not a known"),
        ("signals: {motor_torque_nm: {message: M}}", "needs both message and signal"),
        ("signals: {motor_torque_nm: {column: a, message: M}}", "message: is not a known field"),
        ("signals: {motor_speed_rad_s: {torque_constant_nm_per_a: 0.05}}", "belongs to motor_t"),
        ("signals: {motor_torque_nm: {counts_per_turn: 4096}}", "belongs to motor_angle_rad or"),
        ("signals: {motor_torque_nm: {}}\ntime: {counts_per_turn: 9}", "time: counts_per_turn bel"),
    ],
)
def test_no_mapping_of_a_table_is_passed_over(tmp_path: Path, mapping: str, said: str) -> None:
    path, columns = tmp_path / "rig.csv", tmp_path / "columns.yaml"
    path.write_text(CANONICAL, encoding="utf-8")
    columns.write_text(mapping, encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(said)):
        read_recording(path, signals=columns)


def test_an_entry_without_a_column_is_of_the_canonical_one(tmp_path: Path) -> None:
    path, columns = tmp_path / "rig.csv", tmp_path / "columns.yaml"
    path.write_text(CANONICAL, encoding="utf-8")
    columns.write_text("signals: {motor_torque_nm: {scale: -1}}", encoding="utf-8")
    read = read_recording(path, signals=columns)
    assert read.series["motor_torque_nm"].value.tolist() == [-1.0, -2.0, -3.0]
    assert read.notes == ("columns left out: torque_sensor_nm",)
    columns.write_text("signals: {motor_torque_nm: {}}\ntime: {scale: 1.0e-3}", encoding="utf-8")
    read = read_recording(path, signals=columns)
    assert read.series["motor_torque_nm"].t_ns.tolist() == [0, 100_000, 200_000]


def test_a_bad_part_of_a_sum_is_a_bad_sample(tmp_path: Path) -> None:
    path, columns = tmp_path / "rig.csv", tmp_path / "columns.yaml"
    path.write_text("time_s,l,r\n0,1,1\n1,nan,1\n2,-inf,inf\n3,1,1\n", encoding="utf-8")
    columns.write_text("signals: {rack_force_n: {sum: [l, r], scale: -1}}", encoding="utf-8")
    with pytest.raises(InputError, match="line 3, column rack_force_n: is NaN or infinite"):
        read_recording(path, signals=columns)
    read = read_recording(path, signals=columns, gaps="mark")
    assert read.series["rack_force_n"].value == pytest.approx([-2, np.nan, np.nan, -2], nan_ok=True)
    assert "2 bad samples marked" in read.notes[-1]


def test_what_a_trace_leaves_out_is_said(tmp_path: Path) -> None:
    path = tmp_path / "sim.csv"
    path.write_text("time_s,motor_speed_rad_s\n0,1\n1,nan\n0.5,2\n2,3\n", encoding="utf-8")
    assert read_foreign(path).notes == (
        "1 rows go back in time: left out",
        "motor_speed_rad_s: 1 rows are no finite number: left out",
    )


def counted(folder: Path, counts: np.ndarray, seconds: np.ndarray) -> tuple[str, ...]:
    path, columns = folder / "rig.csv", folder / "columns.yaml"
    np.savetxt(path, np.column_stack([seconds, counts]), delimiter=",", header="t,c", comments="")
    text = "time: {column: t}\nsignals: {motor_angle_rad: {column: c, counts_per_turn: 1000}}"
    columns.write_text(text, encoding="utf-8")
    return read_recording(path, signals=columns).notes


def test_turns_that_counts_may_hide_are_told(tmp_path: Path) -> None:
    seconds = np.arange(1000) * 0.001
    slow, fast = np.arange(1000) * 30 % 1000, np.arange(1000) * 470 % 1000
    assert counted(tmp_path, slow, seconds) == ()
    assert "up to 0.47 turns between two samples" in counted(tmp_path, fast, seconds)[0]
    late = seconds + np.where(seconds > 0.5, 2.0, 0.0)
    assert "whole turns in a gap of 2 s are not counted" in counted(tmp_path, slow, late)[0]


def parquet(folder: Path, table: dict[str, object]) -> Path:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    path = folder / "rig.parquet"
    parquet.write_table(pyarrow.table(table), path)
    return path


@pytest.mark.parametrize("kind", ["datetime64[ns]", "datetime64[us]", "timedelta64[ms]"])
def test_a_clock_of_dates_or_durations_is_a_time(tmp_path: Path, kind: str) -> None:
    clock = np.array([1000, 2000, 4000], kind.partition("[")[0] + "[ms]").astype(kind)
    path, columns = parquet(tmp_path, {"clock": clock, "a": [1, 2, 3]}), tmp_path / "c.yaml"
    columns.write_text("time: {column: clock}\nsignals: {rack_force_n: {column: a}}", "utf-8")
    read = read_recording(path, signals=columns).series["rack_force_n"]
    assert read.t_ns.tolist() == [1_000_000_000, 2_000_000_000, 4_000_000_000]
    text = "time: {column: clock, scale: 0.001}\nsignals: {rack_force_n: {column: a}}"
    columns.write_text(text, "utf-8")
    with pytest.raises(InputError, match="column 'clock': holds instants or durations, which no"):
        read_recording(path, signals=columns)


def test_a_parquet_column_of_something_else_is_named(tmp_path: Path) -> None:
    path = parquet(tmp_path, {"t": [0.0, 1.0, 2.0], "a": ["x", "y", "z"], "b": ["x", "y", "z"]})
    columns = tmp_path / "c.yaml"
    columns.write_text("time: {column: t}\nsignals: {rack_force_n: {column: a}}", "utf-8")
    with pytest.raises(InputError, match="column a: holds string, not numbers"):
        read_recording(path, signals=columns)


def test_a_null_is_no_sample_and_a_nan_a_bad_one(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    force = pyarrow.array([1.0, None, 3.0, None, 5.0])
    torque = pyarrow.array([1.0, 2.0, float("nan"), 4.0, 5.0])
    path = parquet(tmp_path, {"t": [0.0, 1, 2, 3, 4], "f": force, "m": torque})
    columns = tmp_path / "c.yaml"
    columns.write_text(
        "time: {column: t}\nsignals: {rack_force_n: {column: f}, motor_torque_nm: {column: m}}",
        "utf-8",
    )
    with pytest.raises(InputError, match="row 3, column motor_torque_nm: is NaN or infinite"):
        read_recording(path, signals=columns)
    read = read_recording(path, signals=columns, gaps="mark").series
    assert read["rack_force_n"].value.tolist() == [1.0, 3.0, 5.0]
    assert len(read["motor_torque_nm"].value) == 5
