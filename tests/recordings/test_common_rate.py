"""Tables of one rate have no holes, and say what stands in the way of one."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from eps_hil.bus.frame import Frame
from eps_hil.errors import InputError
from eps_hil.recordings.common_rate import HoleError, at_rate
from eps_hil.recordings.conversion import convert
from eps_hil.recordings.read import read_recording
from eps_hil.series import Series

LogWriter = Callable[[str, list[Frame]], Path]

ROOT = Path(__file__).parents[2]
DBC = ROOT / "dbc" / "eps_rig.dbc"
SIGNALS = ROOT / "configs" / "eps_rig_signals.yaml"

MS = 1_000_000


def _ramp(begin_ms: int, end_ms: int, step_ms: int, slope: float = 1.0) -> Series:
    t_ms = np.arange(begin_ms, end_ms + 1, step_ms, dtype=np.int64)
    return Series(t_ms * MS, slope * t_ms.astype(np.float64))


def test_rows_are_where_all_signals_are_and_linear_between_samples() -> None:
    series = {"rack_force_n": _ramp(3, 100, 7), "motor_speed_rad_s": _ramp(0, 95, 1, -2.0)}
    t_ns, columns, notes = at_rate(series, 500.0, gaps="refuse")
    assert t_ns.tolist() == [k * 2 * MS for k in range(2, 48)]
    np.testing.assert_allclose(columns["rack_force_n"], t_ns / MS)
    np.testing.assert_allclose(columns["motor_speed_rad_s"], -2.0 * t_ns / MS)
    assert notes == ()


def test_what_the_rows_leave_out_is_told() -> None:
    series = {"rack_force_n": _ramp(0, 9000, 1), "motor_speed_rad_s": _ramp(2500, 5000, 1)}
    _, _, notes = at_rate(series, 100.0, gaps="refuse")
    assert notes == (
        "rows begin 2.5 s after the recording, with motor_speed_rad_s",
        "rows end 4.0 s before the recording, with motor_speed_rad_s",
    )


def test_a_gap_is_refused_or_marked() -> None:
    force = _ramp(0, 1000, 1)
    kept = (force.t_ns < 300 * MS) | (force.t_ns > 500 * MS)
    series = {
        "rack_force_n": Series(force.t_ns[kept], force.value[kept]),
        "motor_speed_rad_s": _ramp(0, 1000, 1),
    }
    with pytest.raises(HoleError, match=r"rack_force_n has no good sample around 0\.300 s"):
        at_rate(series, 100.0, gaps="refuse")
    t_ns, columns, notes = at_rate(series, 100.0, gaps="mark")
    empty = np.isnan(columns["rack_force_n"])
    assert t_ns[empty].tolist() == [k * 10 * MS for k in range(30, 51)]
    assert notes == ("rack_force_n: 21 of 101 cells are empty",)


def test_slow_signals_have_no_gap_between_their_samples() -> None:
    series = {"motor_temperature_degc": _ramp(0, 3000, 1000), "rack_force_n": _ramp(0, 3000, 1)}
    _, columns, _ = at_rate(series, 10.0, gaps="refuse")
    assert not np.isnan(columns["motor_temperature_degc"]).any()


def test_an_estimate_beside_an_invalid_flag_is_empty_and_no_hole() -> None:
    t_ns = np.arange(10, dtype=np.int64) * MS
    force = np.arange(10.0)
    valid = np.ones(10)
    force[4:6], valid[4:6] = np.nan, 0.0
    series = {"rack_force_estimate_n": Series(t_ns, force), "valid": Series(t_ns, valid)}
    _, columns, notes = at_rate(series, 1000.0, gaps="refuse")
    assert columns["valid"].tolist() == [1, 1, 1, 1, 0, 0, 1, 1, 1, 1]
    assert np.flatnonzero(np.isnan(columns["rack_force_estimate_n"])).tolist() == [4, 5]
    assert notes == ()


def test_signals_that_never_meet_are_refused() -> None:
    series = {"rack_force_n": _ramp(0, 10, 1), "motor_speed_rad_s": _ramp(20, 30, 1)}
    with pytest.raises(HoleError, match="no common stretch"):
        at_rate(series, 100.0, gaps="mark")


@pytest.mark.parametrize("kind", ["csv", "parquet", "mf4"])
def test_convert_writes_a_table_without_holes(
    tmp_path: Path, write_log: LogWriter, rig_frames: list[Frame], kind: str
) -> None:
    log, target = write_log("a.log", rig_frames), tmp_path / f"a.{kind}"
    convert(log, target, dbc=[DBC], signals=SIGNALS, rate_hz=200.0)
    series = read_recording(target).series
    (stamps,) = {one.t_ns.tobytes() for one in series.values()}
    steps = np.diff(np.frombuffer(stamps, np.int64))
    assert steps.tolist() == [5 * MS] * len(steps)
    assert not any(np.isnan(one.value).any() for one in series.values())
    direct = read_recording(log, dbc=[DBC], signals=SIGNALS).series["motor_speed_rad_s"]
    speed = series["motor_speed_rad_s"]
    begin_ns = int(direct.t_ns[0])  # floats do not hold the stamps
    expected = np.interp(speed.t_ns - begin_ns, direct.t_ns - begin_ns, direct.value)
    np.testing.assert_allclose(speed.value, expected, atol=1e-9)


def test_a_hole_names_file_and_remedy(tmp_path: Path) -> None:
    rows = "".join(f"{k / 1000},{k}\n" for k in (*range(300), *range(600, 900)))
    (tmp_path / "a.csv").write_text("time_s,rack_force_n\n" + rows)
    with pytest.raises(InputError, match=r"a\.csv: rack_force_n has no good sample.*--gaps mark"):
        convert(tmp_path / "a.csv", tmp_path / "b.csv", rate_hz=100.0)
