import errno
import io
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil import growing
from eps_hil.errors import EpsHilError, InputError
from eps_hil.recordings import write
from eps_hil.recordings.read import read_columns, read_recording
from eps_hil.recordings.table import from_series
from eps_hil.recordings.write import write_table

SUFFIXES = (".csv", ".parquet", ".mf4")
NAMES = ("motor_torque_nm", "motor_speed_rad_s", "rack_force_n")

finite = st.floats(allow_nan=False, allow_infinity=False)
stamps = st.lists(
    st.integers(-(10**15), 1_900_000_000 * 10**9), min_size=1, max_size=12, unique=True
).map(sorted)


@st.composite
def tables(draw: st.DrawFn) -> tuple[list[int], dict[str, list[float]]]:
    t_ns = draw(stamps)
    column = st.lists(finite, min_size=len(t_ns), max_size=len(t_ns))
    return t_ns, {name: draw(column) for name in NAMES}


@settings(max_examples=150, deadline=None)
@given(tables(), st.sampled_from((".csv", ".parquet")))
def test_round_trip_is_exact(
    tmp_path_factory: pytest.TempPathFactory,
    table: tuple[list[int], dict[str, list[float]]],
    suffix: str,
) -> None:
    t_ns = np.array(table[0], dtype=np.int64)
    columns = {name: np.array(values) for name, values in table[1].items()}
    path = tmp_path_factory.mktemp("table") / f"t{suffix}"
    write_table(path, columns, t_ns=t_ns)
    series = read_recording(path).series
    assert set(series) == set(NAMES)
    for name, column in columns.items():
        np.testing.assert_array_equal(series[name].t_ns, t_ns)
        assert series[name].value.tobytes() == column.tobytes()


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("start_ns", [0, 1_757_617_431_821_276_123])
def test_every_format_keeps_rates_stamps_and_values(
    tmp_path: Path, suffix: str, start_ns: int
) -> None:
    t_ns = start_ns + np.arange(1000) * 1_000_000
    slow = np.where(np.arange(1000) % 10 == 0, np.arange(1000) / 7, np.nan)
    path = tmp_path / f"t{suffix}"
    write_table(
        path,
        {"motor_torque_nm": np.sin(t_ns / 1e9), "yaw_rate_rad_s": slow, "valid": t_ns % 2 == 0},
        t_ns=t_ns,
    )
    series, _ = read_columns(path)
    np.testing.assert_array_equal(series["motor_torque_nm"].t_ns, t_ns)
    np.testing.assert_array_equal(series["motor_torque_nm"].value, np.sin(t_ns / 1e9))
    np.testing.assert_array_equal(series["yaw_rate_rad_s"].t_ns, t_ns[::10])
    np.testing.assert_array_equal(series["yaw_rate_rad_s"].value, slow[::10])
    np.testing.assert_array_equal(series["valid"].value, t_ns % 2 == 0)


def test_csv_text(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    write_table(
        path,
        {
            "time_s": np.array([0.0, 0.001]),
            "rack_force_estimate_n": np.array([np.nan, 0.1 + 0.2]),
            "friction_torque_nm": np.array([1e-7, -5.0]),
            "valid": np.array([0.0, 1.0]),
        },
    )
    assert path.read_text() == (
        "time_s,rack_force_estimate_n,friction_torque_nm,valid\n"
        "0.0,,1e-07,0\n"
        "0.001,0.30000000000000004,-5.0,1\n"
    )


def test_epoch_csv_names_the_nanosecond(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    write_table(path, {"rack_force_n": np.ones(1)}, t_ns=np.array([1_757_617_431_821_276_123]))
    assert path.read_text().splitlines()[1] == "1757617431.821276123,1.0"


@given(
    st.lists(
        st.integers(10**18, 2**32 * 10**9 - 1)
        | st.sampled_from(
            [10**18, 2**32 * 10**9 - 1, 1_757_617_431 * 10**9, 1_999_999_999_999_999_999]
        ),
        min_size=1,
        max_size=20,
    )
)
def test_stamps_of_ten_digits_are_those_of_python(stamps: list[int]) -> None:
    t_ns = np.array(stamps, dtype=np.int64)
    assert write._decimals(t_ns).to_pylist() == [*write._seconds(t_ns)]


@pytest.mark.parametrize("start_ns", [10**18 - 2, 2**32 * 10**9 - 2, 10**15, -(10**16)])
def test_many_rows_are_written_as_few_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start_ns: int
) -> None:
    t_ns = start_ns + np.arange(5)
    columns = {"rack_force_n": np.array([0.1, np.nan, 2.0, -3.0, 4.0])}
    write_table(tmp_path / "few.csv", columns, t_ns=t_ns)
    monkeypatch.setattr(write, "_WORTH_ARROW", 0)
    write_table(tmp_path / "many.csv", columns, t_ns=t_ns)
    np.testing.assert_array_equal(
        read_recording(tmp_path / "many.csv", gaps="mark").series["rack_force_n"].t_ns, t_ns
    )
    few, many = ((tmp_path / f"{name}.csv").read_text().split() for name in ("few", "many"))
    assert [one.split(",")[0] for one in few] == [one.split(",")[0] for one in many]


def test_no_more_text_waits_for_a_slow_disk_than_a_few_pieces(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, written, waiting = [], bytearray(), []
    by_arrow = pyarrow.csv.write_csv

    def counted(*given: Any) -> None:
        by_arrow(*given)
        made.append(1)

    class Slow(io.BytesIO):
        def write(self, text: Any) -> int:
            time.sleep(0.01)
            waiting.append(len(made))
            written.extend(text)
            return len(text)

    monkeypatch.setattr(pyarrow.csv, "write_csv", counted)
    monkeypatch.setattr(write, "_ROWS", 10)
    write._write_by_arrow(Slow(), {"time_s": np.arange(1_000) / 4}, None)
    assert [float(line) for line in written.split()] == [k / 4 for k in range(1_000)]
    most = max(count - k for k, count in enumerate(waiting))
    assert 1 < most <= write._AHEAD * (os.cpu_count() or 1)


def test_union_of_stamps_holds_every_sample(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    text = "time_s,motor_torque_nm,rack_force_n\n0,1,\n0.4,,5\n1,2,\n2,3,\n2.4,,6\n3,4,\n"
    path.write_text(text)
    series = read_recording(path).series
    t_ns, columns = from_series(series)
    write_table(tmp_path / "again.csv", columns, t_ns=t_ns)
    again = read_recording(tmp_path / "again.csv").series
    for name, one in series.items():
        np.testing.assert_array_equal(again[name].t_ns, one.t_ns)
        np.testing.assert_array_equal(again[name].value, one.value)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("t.xlsx", "suffix '.xlsx' is no table format; name it with one of .csv"),
        ("t", "suffix '' is no table format"),
        ("nowhere/t.csv", "does not exist; create it first"),
        ("folder.csv", "is a folder"),
    ],
)
def test_bad_target_is_refused(tmp_path: Path, name: str, expected: str) -> None:
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(InputError) as caught:
        write_table(tmp_path / name, {"time_s": np.zeros(1), "rack_force_n": np.zeros(1)})
    assert expected in str(caught.value)


def test_full_disk_leaves_the_old_file_and_no_litter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / "t.csv"
    path.write_text("old")
    monkeypatch.setattr(write, "_write_rows", full)
    with pytest.raises(EpsHilError, match=r"t\.csv: the disk is full") as caught:
        write_table(path, {"time_s": np.zeros(1), "rack_force_n": np.zeros(1)})
    assert caught.value.exit_status == 1
    assert path.read_text() == "old"
    assert [each.name for each in tmp_path.iterdir()] == ["t.csv"]


def test_columns_of_different_length_are_a_mistake_of_ours(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="differ in length"):
        write_table(tmp_path / "t.csv", {"time_s": np.zeros(2), "rack_force_n": np.zeros(1)})


def test_a_long_csv_holds_what_a_short_one_does(tmp_path: Path) -> None:
    """From some ten thousand rows on pyarrow writes it."""
    n = 25_000
    rng = np.random.default_rng(3)
    force = rng.normal(0, 1e3, n) * 10.0 ** rng.integers(-12, 12, n)
    force[[3, 4, 20_000]] = np.nan, 0.1, 1.0
    columns = {"rack_force_estimate_n": force, "valid": np.arange(n) % 2 == 0}
    for start_ns in (0, 1_757_617_431_821_276_007, -1_500_000_000):
        t_ns = start_ns + np.arange(n) * 1_000_000
        whole, part = tmp_path / "whole.csv", tmp_path / "part.csv"
        write_table(whole, columns, t_ns=t_ns)
        write_table(part, {name: one[:10] for name, one in columns.items()}, t_ns=t_ns[:10])
        head, *rows = whole.read_text().splitlines()
        assert len(rows) == n
        assert head == part.read_text().splitlines()[0]
        for row, short in zip(rows, part.read_text().splitlines()[1:], strict=False):
            cells = zip(row.split(","), short.split(","), strict=True)
            assert all(a == b or float(a) == float(b) for a, b in cells)
        back = read_columns(whole, gaps="mark")[0]
        assert np.array_equal(back["rack_force_estimate_n"].value, force[~np.isnan(force)]) or (
            np.array_equal(back["rack_force_estimate_n"].value, force, equal_nan=True)
        )
        assert np.array_equal(back["valid"].t_ns, t_ns)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("start_ns", [0, 1_757_617_431_821_276_001])
@pytest.mark.parametrize("rows", [0, 30, 25_000])
def test_written_block_by_block_it_reads_the_same(
    tmp_path: Path, suffix: str, start_ns: int, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    force = np.where(np.arange(rows) % 9 == 2, np.nan, np.arange(rows) / 7)
    columns = {"rack_force_estimate_n": force, "valid": np.arange(rows) % 2 == 0}
    t_ns = start_ns + 1_000_000 * np.arange(rows)
    names = [f"{name}{suffix}" for name in ("whole", "blocks")]
    write_table(tmp_path / names[0], columns, t_ns=t_ns)
    monkeypatch.setattr(growing, "_BLOCK", 11 if rows < 100 else 7_001)
    write_table(tmp_path / names[1], columns, t_ns=t_ns)
    if suffix == ".csv":
        assert (tmp_path / names[0]).read_bytes() == (tmp_path / names[1]).read_bytes()
    else:
        whole, parts = (pyarrow.parquet.read_table(tmp_path / name) for name in names)
        assert whole.equals(parts, check_metadata=True)
        assert whole.num_rows == rows
