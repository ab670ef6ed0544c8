"""Data frames and arrays become recordings by the rules of files; mistakes are one line."""

import importlib
import re
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.recordings.in_memory import from_arrays

TIME_S = np.arange(5) * 1e-3
TORQUE = np.array([0.1, 0.2, 0.3, 0.4, 0.5])


def table(**other: Any) -> dict[str, Any]:
    return {"time_s": TIME_S, "motor_torque_nm": TORQUE, **other}


@pytest.mark.parametrize(
    "torque",
    [
        TORQUE,
        TORQUE.astype(np.float32),
        np.repeat(TORQUE, 2)[::2],
        list(TORQUE),
        TORQUE.astype(object),
        np.array([str(each) for each in TORQUE], dtype=object),
    ],
    ids=["float64", "float32", "strided", "list", "objects", "words in objects"],
)
@pytest.mark.parametrize(
    "clock",
    [
        {"time_s": TIME_S},
        {"time_s": TIME_S.astype(np.float32).astype(float)},
        {"time_ns": np.arange(5) * 1_000_000},
        {"time_ns": np.arange(5, dtype=np.uint32) * 1_000_000},
        {"time_s": np.datetime64("2026-11-30T03:00:00") + np.arange(5) * np.timedelta64(1, "ms")},
        {"time_s": np.arange(5) * np.timedelta64(1, "ms")},
    ],
    ids=["s", "s of float32", "ns", "ns of uint32", "datetime64", "timedelta64"],
)
def test_numbers_and_clocks_of_any_type(torque: Any, clock: dict[str, Any]) -> None:
    made = from_arrays({**clock, "motor_torque_nm": torque})
    one = made.series["motor_torque_nm"]
    assert one.t_ns.dtype == np.int64
    assert one.value.dtype == np.float64
    assert np.diff(one.t_ns).tolist() == 4 * [1_000_000]
    assert one.value == pytest.approx(TORQUE, rel=1e-6)


def test_a_date_is_nanoseconds_since_1970() -> None:
    begin = np.datetime64("2026-11-30T03:00:00.000000001", "ns")
    made = from_arrays(table(time_s=begin + np.arange(5) * np.timedelta64(1, "ms")))
    assert int(made.series["motor_torque_nm"].t_ns[0]) == 1_796_007_600_000_000_001


def test_dates_of_a_time_zone_are_instants() -> None:
    pandas = importlib.import_module("pandas")
    zone = timezone(timedelta(hours=1))
    begin = datetime(2026, 11, 30, 4, tzinfo=zone)
    dates = [begin + k * timedelta(milliseconds=1) for k in range(5)]
    series = pandas.Series(dates)
    for clock in (dates, series, series.dt.tz_convert("Europe/Berlin"), pandas.DatetimeIndex(dates),
                  [one.astimezone(UTC).replace(tzinfo=None) for one in dates]):  # fmt: skip
        made = from_arrays({"time_s": clock, "motor_torque_nm": TORQUE})
        t_ns = made.series["motor_torque_nm"].t_ns
        assert t_ns.tolist() == [1_796_007_600_000_000_000 + k * 1_000_000 for k in range(5)]
    with pytest.raises(InputError, match="row 2, column time_s: has no time"):
        from_arrays({"time_s": series.where(series != dates[2]), "motor_torque_nm": TORQUE})


def test_a_signal_of_another_rate_has_samples_of_its_own() -> None:
    angle = np.array([1.0, np.nan, 2.0, np.nan, 3.0])
    made = from_arrays(table(motor_angle_rad=angle))
    assert made.series["motor_angle_rad"].t_ns.tolist() == [0, 2_000_000, 4_000_000]
    masked = from_arrays(table(motor_angle_rad=np.ma.masked_invalid(angle)))
    assert masked.series["motor_angle_rad"].value.tolist() == [1.0, 2.0, 3.0]


def test_what_is_masked_is_missing_whatever_its_type() -> None:
    mask = [False, True, False, True, False]
    for numbers in (np.array([1, 0, 2, 0, 3]), np.array([1.0, 0.0, 2.0, 0.0, 3.0])):
        made = from_arrays(table(motor_angle_rad=np.ma.array(numbers, mask=mask)))
        assert made.series["motor_angle_rad"].value.tolist() == [1.0, 2.0, 3.0]
    for clock in (np.arange(5), np.arange(5) * np.timedelta64(1, "s")):
        with pytest.raises(InputError, match="drive: row 1, column time_"):
            from_arrays({"time_ns": np.ma.array(clock, mask=mask), "rack_force_n": TORQUE}, "drive")


def test_a_data_frame() -> None:
    frame = importlib.import_module("pandas").DataFrame(table(note=list("abcde")))
    with pytest.raises(InputError, match="drive: columns: column 'note' is not a canonical name"):
        from_arrays(frame, "drive")
    made = from_arrays(frame, "drive", ignore_unknown=True)
    assert made.series["motor_torque_nm"].value.tolist() == TORQUE.tolist()
    assert made.notes == ("columns left out: 'note'",)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ([1, 2], "drive: is of type list; give a mapping of arrays or a data frame"),
        ({"motor_torque_nm": TORQUE}, "column time_s is missing"),
        ({"time_s": TIME_S}, "no column holds a canonical signal"),
        ({"time_s": [], "motor_torque_nm": []}, "has no rows"),
        (table(motor_torque_nm=TORQUE[:4]), "column motor_torque_nm: has 4 values"),
        (table(motor_torque_nm=np.ones((5, 2))), "column motor_torque_nm: has the shape (5, 2)"),
        (table(motor_torque_nm=list("abcde")), "column motor_torque_nm: holds <U1, not numbers"),
        (
            table(motor_torque_nm=np.array([1.0, "x", 2.0, 3.0, 4.0], object)),
            "row 1, column motor_torque_nm: holds 'x', not a number",
        ),
        (table(motor_torque_nm=TORQUE * 1j), "holds complex128, not numbers"),
        (table(motor_torque_nm=np.where(TIME_S[1] == TIME_S, np.inf, TORQUE)), "row 1"),
        (table(time_s=TIME_S[::-1]), "row 1, column time_s: time goes back from"),
        (table(time_s=0 * TIME_S), "row 1, column time_s: time repeats at 0.0 s"),
        (table(time_s=np.array([0, 1, np.nan, 3, 4])), "row 2, column time_s: is empty"),
        (table(time_s=np.array(5 * ["NaT"], "datetime64[ns]")), "row 0, column time_s: has no"),
        ({0: TIME_S, "motor_torque_nm": TORQUE}, "has a column 0"),
    ],
)  # fmt: skip
def test_a_mistake_names_its_place(columns: Any, said: str) -> None:
    with np.errstate(divide="ignore"), pytest.raises(InputError, match=re.escape(said)):
        from_arrays(columns, "drive")


def test_two_clocks_that_say_something_else_are_told() -> None:
    t_ns = np.arange(5) * 1_000_000
    assert from_arrays(table(time_ns=t_ns)).notes == ()
    made = from_arrays(table(time_ns=t_ns * 3))
    assert made.series["motor_torque_nm"].t_ns.tolist() == (t_ns * 3).tolist()
    assert made.notes == ("time_s and time_ns are up to 0.008 s apart: time_ns is taken",)
