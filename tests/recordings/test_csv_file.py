import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.errors import InputError
from eps_hil.recordings import csv_file
from eps_hil.recordings.read import read_recording
from eps_hil.recordings.recording import Recording


@pytest.fixture(autouse=True, params=[0, 1 << 40], ids=["pyarrow", "numpy"])
def parser(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every file is read by both parsers: small ones would only go to one of them."""
    monkeypatch.setattr(csv_file, "_WORTH_ARROW", request.param)


large = pytest.mark.parametrize("parser", [0], ids=["pyarrow"], indirect=True)
"""For what only a large file's parser does, or a test that calls both."""
HEADER = "time_s,motor_torque_nm,motor_speed_rad_s\n"


def _written(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "ride.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def _read(tmp_path: Path, text: str | bytes, gaps: str = "refuse") -> Recording:
    return read_recording(_written(tmp_path, text), gaps=gaps)


def _samples(recording: Recording, name: str) -> list[tuple[int, float]]:
    series = recording.series[name]
    return list(zip(series.t_ns.tolist(), series.value.tolist(), strict=True))


REFUSED = [
    ("text", HEADER + "0,1,2\n1,abc,3\n", "line 3, column motor_torque_nm: 'abc' is not a number"),
    ("text after blank line", HEADER + "0,1,2\n\n1,2,x\n", "line 4, column motor_speed_rad_s: 'x'"),
    ("umlaut", HEADER + "0,1,ä\n", "line 2, column motor_speed_rad_s"),
    ("hexadecimal", HEADER + "0,0x10,2\n", "line 2, column motor_torque_nm: '0x10'"),
    ("underscore", HEADER + "0,1_0,2\n", "line 2, column motor_torque_nm: '1_0'"),
    ("time repeats", HEADER + "0,1,2\n0,1,2\n", "line 3, column time_s: time repeats at 0.0 s"),
    ("time backwards", HEADER + "1,1,2\n0.5,1,2\n", "line 3, column time_s: time goes back from"),
    ("time missing in a row", HEADER + "0,1,2\n,1,2\n", "line 3, column time_s: is empty"),
    ("time infinite", HEADER + "inf,1,2\n", "line 2, column time_s: is not a time"),
    ("NaN", HEADER + "0,1,2\n1,nan,2\n", "line 3, column motor_torque_nm: is NaN or infinite"),
    ("inf", HEADER + "0,1,2\n1,1,-Inf\n", "line 3, column motor_speed_rad_s: is NaN or infinite"),
    ("overflow", HEADER + "0,1e999,2\n", "line 2, column motor_torque_nm: is NaN or infinite"),
    ("hole", HEADER + "0,1,2\n1,,2\n2,1,2\n3,1,2\n", "line 3, column motor_torque_nm: is empty"),
    ("unknown", "time_s,motor_torque\n0,1\n", "'motor_torque' is not a canonical name; rename it"),
    ("nearest", "time_s,Motor Speed\n0,1\n", "rename it to motor_speed_rad_s, or give --ignore-un"),
    ("unnamed", "time_s,,motor_torque_nm\n0,1,2\n", "column '' is not a canonical name"),
    (
        "twice",
        "time_s,rack_force_n,rack_force_n\n0,1,2\n",
        "line 1: column 'rack_force_n' is there",
    ),
    ("no time", "motor_torque_nm\n1\n", "line 1: column time_s is missing"),
    ("no signal", "time_s\n0\n", "line 1: no column holds a canonical signal"),
    ("no header", "0,1\n1,2\n", "line 1: holds numbers, no column names"),
    ("header only", HEADER, "line 2: nothing follows the header"),
    ("only blank lines", HEADER + "\n \n\n", "line 2: nothing follows the header"),
    ("only commas", HEADER + ",,\n,,\n", "line 2: all cells are empty"),
    ("empty", "", "is empty (0 bytes)"),
    ("blank", " \n\n", "is empty"),
    ("short row", HEADER + "0,1,2\n1,2\n2,1,2\n", "line 3: 2 cells where the header has 3; mend"),
    ("cut off", HEADER + "0,1,2\n1,2", "line 3: 2 cells where the header has 3; the file may be c"),
    ("long row", HEADER + "0,1,2\n1,2,3,4\n", "line 3: 4 cells where the header has 3"),
    (
        "semicolons",
        "time_s;motor_torque_nm\n0,1;2,5\n",
        "a semicolon, not a comma and numbers have",
    ),
    ("tabs", "time_s\tmotor_torque_nm\n0\t1\n", "separated by a tab"),
    ("decimal comma", HEADER + '0,"1,5",2\n', "column motor_torque_nm: '1,5' has a decimal comma"),
    ("quotes", HEADER + '0,"1,2\n', "line 2: quotes do not match"),
    ("header quotes", '"time_s\n0\n', "line 1: quotes do not match"),
    ("latin-1 header", b"time_s,Temperatur \xb0C\n0,1\n", "line 1: is not UTF-8 text (byte 0xb0)"),
    ("binary", HEADER.encode() + b"0,1,2\n\x00\x01", "line 3: holds binary data"),
    ("UTF-16", HEADER.encode("utf-16"), "is UTF-16 text; save it as 'CSV UTF-8'"),
]


@pytest.mark.parametrize(
    ("text", "expected"), [r[1:] for r in REFUSED], ids=[r[0] for r in REFUSED]
)
def test_bad_table_is_refused_by_file_place_and_problem(
    tmp_path: Path, text: str | bytes, expected: str
) -> None:
    with pytest.raises(InputError) as caught:
        _read(tmp_path, text)
    assert expected in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "ride.csv"))
    assert "\n" not in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize(
    "text",
    [
        HEADER + "0,1,2\n1,3,4\n",
        HEADER + "0,1,2\n1,3,4",
        "\ufeff" + HEADER.replace("\n", "\r\n") + "0,1,2\r\n1,3,4\r\n",
        HEADER.replace("\n", "\r") + "0,1,2\r1,3,4\r",
        HEADER.replace("\n", "\r") + "0,1,2\n1,3,4\r",
        HEADER.replace("\n", "\r\n") + "0,1,2\n1,3,4\n",
        "time_s,motor_torque_nm,motor_speed_rad_s,\n0,1,2,\n1,3,4,\n",
        "time_s,motor_torque_nm,motor_speed_rad_s,\n0,1,2\n1,3,4\n",
        HEADER + "0,1,2,\n1,3,4,\n",
        HEADER + " 0, 1 ,2\n1,\t3,4\n",
        HEADER + '"0","1","2"\n1, "3" ,4\n',
        HEADER + "\n0,1,2\n\n1,3,4\n\n,,\n",
        '"time_s" , motor_torque_nm,motor_speed_rad_s\n+0.0,1e0,2.\n1,3,.4e1\n',
    ],
    ids=[
        "plain", "no last newline", "BOM and CRLF", "CR", "CR and LF",
        "CRLF once", "commas end lines", "comma ends header",
        "comma ends rows", "blanks", "quotes", "blank lines", "number spellings",
    ],
)  # fmt: skip
def test_spreadsheet_habits_are_taken(tmp_path: Path, text: str) -> None:
    recording = _read(tmp_path, text)
    assert _samples(recording, "motor_torque_nm") == [(0, 1.0), (1_000_000_000, 3.0)]
    assert _samples(recording, "motor_speed_rad_s") == [(0, 2.0), (1_000_000_000, 4.0)]


@pytest.mark.parametrize("piece", [1, 2, 3, 7])
def test_signs_are_seen_wherever_the_pieces_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int
) -> None:
    monkeypatch.setattr(csv_file, "_PIECE", piece)
    recording = _read(tmp_path, HEADER + '0,"1",2\r\n1 ,\t3,4\r\n')
    assert _samples(recording, "motor_torque_nm") == [(0, 1.0), (1_000_000_000, 3.0)]
    assert _samples(recording, "motor_speed_rad_s") == [(0, 2.0), (1_000_000_000, 4.0)]


@pytest.mark.parametrize(
    ("text", "line"),
    [("time_s,\0\n0,1\n", "line 1:"), ("time_s,rack_force_n\n\n0,1\n\0", "line 4:")],
)
def test_binary_data_is_placed(tmp_path: Path, text: str, line: str) -> None:
    with pytest.raises(InputError, match=f"{line} holds binary data"):
        _read(tmp_path, text)


def test_slow_signal_has_fewer_samples(tmp_path: Path) -> None:
    recording = _read(tmp_path, HEADER + "0,1,2\n1,,3\n2,4,5\n3,,6\n")
    assert _samples(recording, "motor_torque_nm") == [(0, 1.0), (2_000_000_000, 4.0)]
    assert len(recording.series["motor_speed_rad_s"].t_ns) == 4


def test_signals_at_their_own_instants_are_no_holes(tmp_path: Path) -> None:
    rows = "".join(f"{i}.0,{i},\n" + (f"{i}.5,,7\n" if i % 3 == 0 else "") for i in range(9))
    recording = _read(tmp_path, HEADER + rows)
    assert [t for t, _ in _samples(recording, "motor_torque_nm")] == [
        i * 1_000_000_000 for i in range(9)
    ]
    assert len(recording.series["motor_speed_rad_s"].t_ns) == 3


def test_half_rate_may_start_and_end_the_file(tmp_path: Path) -> None:
    rows = "".join(f"{i},{i if i % 2 == 0 else ''},{i}\n" for i in range(5))
    assert len(_read(tmp_path, HEADER + rows).series["motor_torque_nm"].t_ns) == 3


def test_half_rate_fills_more_than_half_where_rows_are_lost(tmp_path: Path) -> None:
    kept = [i for i in range(200) if i % 2 == 0 or i % 10 != 3]
    rows = "".join(f"{i},{i if i % 2 == 0 else ''},{i}\n" for i in kept)
    assert len(_read(tmp_path, HEADER + rows).series["motor_torque_nm"].t_ns) == 100


def test_signal_may_start_later(tmp_path: Path) -> None:
    recording = _read(
        tmp_path, HEADER + "0,,2\n1,,2\n" + "".join(f"{i},1,2\n" for i in range(2, 9))
    )
    assert recording.series["motor_torque_nm"].t_ns[0] == 2_000_000_000


def test_gaps_mark_keeps_bad_samples_as_nan(tmp_path: Path) -> None:
    text = HEADER + "0,1,2\n1,,2\n2,NaN,2\n3,-inf,2\n4,1e999,2\n5,6,2\n6,7,2\n7,8,2\n8,9,2\n"
    recording = _read(tmp_path, text, gaps="mark")
    series = recording.series["motor_torque_nm"]
    np.testing.assert_array_equal(series.t_ns, np.arange(9) * 1_000_000_000)
    np.testing.assert_array_equal(series.value, [1, *[np.nan] * 4, 6, 7, 8, 9])
    assert recording.notes == ("column motor_torque_nm: 4 bad samples marked",)


def test_row_without_any_value_is_a_hole(tmp_path: Path) -> None:
    text = "time_s,motor_torque_nm\n0,1\n1,\n2,3\n3,4\n"
    with pytest.raises(InputError, match=r"line 3, column motor_torque_nm"):
        _read(tmp_path, text)


def test_estimate_said_to_be_invalid_may_be_empty(tmp_path: Path) -> None:
    text = "time_s,rack_force_estimate_n,valid\n0,,0\n1,5,1\n2,6,1\n3,7,1\n"
    series = _read(tmp_path, text).series
    assert list(series) == ["rack_force_estimate_n"]
    np.testing.assert_array_equal(series["rack_force_estimate_n"].value, [np.nan, 5, 6, 7])


def test_unknown_columns_may_be_ignored_whatever_they_hold(tmp_path: Path) -> None:
    text = 'time_s,note,motor_torque_nm\n0,"a, b",1\n1,nan ä,2\n'
    recording = read_recording(_written(tmp_path, text), ignore_unknown=True)
    assert _samples(recording, "motor_torque_nm") == [(0, 1.0), (1_000_000_000, 2.0)]
    assert recording.notes == ("columns left out: 'note'",)


def test_decimal_time_is_exact(tmp_path: Path) -> None:
    rows = "".join(f"{k / 1000:.3f},1\n" for k in range(5000))
    recording = _read(tmp_path, "time_s,motor_torque_nm\n" + rows)
    t_ns = recording.series["motor_torque_nm"].t_ns
    np.testing.assert_array_equal(t_ns, np.arange(5000) * 1_000_000)


def test_epoch_time_is_exact_to_the_nanosecond(tmp_path: Path) -> None:
    rows = "1757617431.821276123,1\n\n,\n1757617431.822276,2\n1.757617432e9,3\n"
    recording = _read(tmp_path, "time_s,motor_torque_nm\n" + rows)
    assert recording.series["motor_torque_nm"].t_ns.tolist() == [
        1_757_617_431_821_276_123,
        1_757_617_431_822_276_000,
        1_757_617_432_000_000_000,
    ]


_CELL = st.one_of(
    st.floats(allow_nan=False).map(repr),
    st.floats(allow_nan=False).map(lambda value: f"{value:.6e}"),
    st.integers(-(10**30), 10**30).map(str),
    st.from_regex(
        r"[+-]?([0-9]{1,25}\.?[0-9]{0,25}|\.[0-9]{1,25})(e[+-]?[0-9]{1,3})?", fullmatch=True
    ),
    st.sampled_from(["", "inf", "-inf", "infinity"]),
)


@large
@given(st.lists(st.tuples(_CELL, _CELL, _CELL), min_size=1, max_size=20), st.booleans())
def test_both_parsers_read_the_same_to_the_last_bit(
    rows: list[tuple[str, str, str]], blank: bool
) -> None:
    body = ("\n\n" if blank else "\n").join(",".join(row) for row in rows)
    text, used = f"{body}\n".lower().encode(), [2, 0]
    found = csv_file._by_arrow(text, used, 3)
    assert found is not None
    by_arrow = found[0]
    columns = {"motor_torque_nm": 2, "time_s": 0}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(csv_file, "_WORTH_ARROW", 1 << 40)
        by_numpy = csv_file.cells_of(Path("ride.csv"), text, columns)
    np.testing.assert_array_equal(by_arrow, by_numpy)
    np.testing.assert_array_equal(np.signbit(by_arrow), np.signbit(by_numpy))


EPOCH = [1_757_617_431_821_276_123, 1_757_617_431_822_276_001, 1_757_617_432_000_000_000]


@large
@pytest.mark.parametrize("column", ["time_s", "time_ns"])
def test_stamps_of_a_large_file_are_exact(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, column: str
) -> None:
    monkeypatch.setattr(csv_file, "_nanoseconds", None)  # cell by cell is another path
    monkeypatch.setattr(csv_file, "_integer", None)
    cells = EPOCH if column == "time_ns" else [f"{t // 10**9}.{t % 10**9:09d}" for t in EPOCH]
    rows = "".join(f"{cell},{k}\n" for k, cell in enumerate(cells))
    recording = _read(tmp_path, f"{column},motor_torque_nm\n\n" + rows)
    assert recording.series["motor_torque_nm"].t_ns.tolist() == EPOCH


@large
@pytest.mark.parametrize(
    ("row", "place", "problem"),
    [
        ("1757617433.5", "line 5", "1 cells where the header has 2"),
        ("1757617433.5,1,2", "line 5", "3 cells where the header has 2"),
        ("x,1", "line 5, column time_s", "'x' is not a number"),
        (",1", "line 5, column time_s", "is empty"),
        ("1757617433.5,nan", "line 5, column motor_torque_nm", "is NaN or infinite"),
    ],
)
def test_what_is_wrong_with_a_large_file_is_named(
    tmp_path: Path, row: str, place: str, problem: str
) -> None:
    rows = "".join(f"{t // 10**9}.{t % 10**9:09d},1\n" for t in EPOCH)
    with pytest.raises(InputError) as raised:
        _read(tmp_path, f"time_s,motor_torque_nm\n{rows}{row}\n1757617434.5,1\n")
    assert place in str(raised.value)
    assert problem in str(raised.value)


@large
def test_more_than_nine_places_are_rounded(tmp_path: Path) -> None:
    rows = "1757617431.8212761236,1\n1757617432.5,1\n"
    recording = _read(tmp_path, "time_s,motor_torque_nm\n" + rows)
    t_ns = recording.series["motor_torque_nm"].t_ns.tolist()
    assert t_ns == [1_757_617_431_821_276_124, 1_757_617_432_500_000_000]


@pytest.mark.slow
def test_twenty_minutes_are_read_in_seconds(tmp_path: Path) -> None:
    line = ",-0.12345678901234567,98.76543210987654,1.0,-2.5,3.25,0.001,7\n"
    names = (
        "time_s,motor_torque_nm,torque_sensor_nm,motor_speed_rad_s,motor_angle_rad,"
        "rack_force_n,rack_position_m,yaw_rate_rad_s\n"
    )
    rows = 1_200_000
    path = _written(tmp_path, names + "".join(f"{k / 1000:.3f}{line}" for k in range(rows)))
    start = time.process_time()
    recording = read_recording(path)
    assert time.process_time() - start < 20  # some 4 s; the slow path would take minutes
    assert len(recording.series["rack_force_n"].t_ns) == rows
