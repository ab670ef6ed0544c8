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
        ("t,a\n0,1\n0,2\n", "{column: a}", "row 2"),
        ("t,a\n0,1\n1,2\n", "{column: b}", "column 'b': is missing; there are: t, a"),
        ("t,a\n0,1\n1,2\n", "{scale: 2.0}", "needs a column, or a sum of columns"),
        ("t,a\n0,1\n1,2\n", "{column: a, sum: [a]}", "needs a column, or a sum of columns"),
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
