"""Mapped channels of a measurement MF4: each keeps its own stamps."""

import re
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.recordings.foreign import load_columns, read_foreign
from eps_hil.recordings.mf4_values import check_time_axis
from eps_hil.recordings.read import read_recording
from eps_hil.recordings.recording import Recording

asammdf = pytest.importorskip("asammdf")

T = np.arange(0.0, 6.0, 0.001)
TURNS = 50.0 * T / (2 * np.pi)
COUNTS = (np.floor(TURNS * 4096) % 4096).astype(np.uint16)


def channel(name: str, values: Any, seconds: np.ndarray, **more: Any) -> Any:
    return asammdf.Signal(np.asarray(values), seconds, name=name, **more)


def read(folder: Path, groups: list[list[Any]], mapping: str, **options: Any) -> Recording:
    path, columns = folder / "rig.mf4", folder / "columns.yaml"
    with asammdf.MDF(version="4.10") as mdf:
        for group in groups:
            mdf.append(group)
        mdf.header.start_time = datetime(2026, 1, 1, tzinfo=UTC)
        mdf.save(path, overwrite=True)
    columns.write_text(mapping, encoding="utf-8")
    if options.pop("foreign", False):
        return read_foreign(path, load_columns(columns))
    return read_recording(path, signals=columns, **options)


START_NS = 1_767_225_600_000_000_000
MAPPING = """
signals:
  motor_torque_nm: {column: trq}
  motor_angle_rad: {column: cnt, counts_per_turn: 4096}
  rack_force_n: {column: F}
  motor_speed_rad_s: {column: spd}
"""


def groups() -> list[list[Any]]:
    """Torque at 1 kHz, counts at 500 Hz, a force of part of the time, a speed with a hole."""
    kept = np.r_[0:1000, 2500:5999]
    return [
        [channel("trq", np.sin(T), T)],
        [channel("cnt", COUNTS[::2], T[::2])],
        [channel("F", 1000 * np.sin(T[2000:4000]), T[2000:4000])],
        [channel("spd", 50 * np.cos(T[kept]), T[kept])],
    ]


def test_every_channel_keeps_its_own_samples(tmp_path: Path) -> None:
    found = read(tmp_path, groups(), MAPPING).series
    angle = found["motor_angle_rad"]
    stamps = START_NS + np.rint(T * 1e9).astype(np.int64)
    np.testing.assert_array_equal(angle.t_ns, stamps[::2])
    np.testing.assert_allclose(angle.value, 50 * T[::2], atol=2 * np.pi / 4096)
    np.testing.assert_array_equal(found["rack_force_n"].t_ns, stamps[2000:4000])
    np.testing.assert_array_equal(found["rack_force_n"].value, 1000 * np.sin(T[2000:4000]))
    np.testing.assert_array_equal(found["motor_torque_nm"].t_ns, stamps)
    speed = found["motor_speed_rad_s"]
    assert len(speed.t_ns) == 1000 + 3499
    assert np.diff(speed.t_ns).max() == 1_501_000_000


def test_the_files_own_time_is_in_seconds(tmp_path: Path) -> None:
    time = "time: {column: ms, scale: 0.001}"
    found = read(tmp_path, groups(), time + MAPPING)
    assert found.series["motor_torque_nm"].t_ns[-1] == START_NS + 5_999_000_000
    assert "time is the file's own, in seconds: no channel 'ms' beside it" in found.notes


def test_a_channel_that_the_mapping_names_is_the_time(tmp_path: Path) -> None:
    time = "time: {column: ms, scale: 0.001}\n"
    one = [channel("trq", np.sin(T), T), channel("ms", 2000.0 * T, T)]
    mapping = time + "signals: {motor_torque_nm: {column: trq}}"
    found = read(tmp_path, [one], mapping).series["motor_torque_nm"]
    np.testing.assert_array_equal(found.t_ns, np.rint(2e9 * T).astype(np.int64))
    mapping = time + "signals: {rack_force_n: {column: F}}"
    with pytest.raises(InputError, match="channel 'F': is not in the channel group of the time"):
        read(tmp_path, [one, [channel("F", np.sin(T), T)]], mapping)
    back = channel("ms", np.where(T < 3, T, T - 1), T)
    with pytest.raises(InputError, match="sample 3001, channel ms: time goes back"):
        read(tmp_path, [[one[0], back]], time + "signals: {motor_torque_nm: {column: trq}}")


def test_channels_of_the_times_name_are_left_alone(tmp_path: Path) -> None:
    groups = [[channel(name, T, T), channel("time_s", T * 0, T)] for name in ("trq", "spd")]
    mapping = "signals: {motor_torque_nm: {column: trq}, motor_speed_rad_s: {column: spd}}"
    found = read(tmp_path, groups, mapping).series["motor_torque_nm"]
    assert found.t_ns[-1] == START_NS + 5_999_000_000


def test_bad_samples_are_refused_or_marked(tmp_path: Path) -> None:
    bits = np.zeros(len(T), bool)
    bits[100:105] = True
    values = np.sin(T)
    values[200] = np.inf
    group = [channel("trq", values, T, invalidation_bits=bits)]
    mapping = "signals: {motor_torque_nm: {column: trq}}"
    with pytest.raises(InputError, match="sample 101, channel 'trq': is NaN, infinite or marked"):
        read(tmp_path, [group], mapping)
    found = read(tmp_path, [group], mapping, gaps="mark")
    bad = np.flatnonzero(np.isnan(found.series["motor_torque_nm"].value))
    assert bad.tolist() == [100, 101, 102, 103, 104, 200]
    assert "channel 'trq': 6 bad samples marked" in found.notes


def changed(path: Path, change: Callable[[Any], None]) -> Path:
    """The file with its first group changed."""
    with asammdf.MDF(path) as mdf:
        change(mdf.groups[0])
        mdf.save(path.with_name("changed.mf4"), overwrite=True)
    return path.with_name("changed.mf4")


def test_samples_that_are_not_over_time_are_refused(tmp_path: Path) -> None:
    mapping = "signals: {motor_speed_rad_s: {column: motor_speed_rad_s}}"
    timed = "time: {column: clock}\n" + mapping
    read(tmp_path, [[channel("motor_speed_rad_s", T, T), channel("clock", T, T)]], mapping)
    (tmp_path / "timed.yaml").write_text(timed)

    def over(axis: int) -> Callable[[Any], None]:
        return lambda group: setattr(group.channels[0], "sync_type", axis)

    for axis, said in ((2, "an angle"), (3, "a distance"), (4, "a count")):
        path = changed(tmp_path / "rig.mf4", over(axis))
        for options in ({"signals": tmp_path / "columns.yaml"}, {"ignore_unknown": True}):
            with pytest.raises(InputError, match=f"speed_rad_s.: is recorded over {said}, not"):
                read_recording(path, **options)
        found = read_recording(path, signals=tmp_path / "timed.yaml").series
        assert found["motor_speed_rad_s"].t_ns[-1] == 5_999_000_000

    def without(group: Any) -> None:
        group.channels[0].channel_type = group.channels[0].sync_type = 0

    path = changed(tmp_path / "rig.mf4", without)
    with pytest.raises(InputError, match="channel 'motor_speed_rad_s': has no time beside it"):
        read_recording(path, ignore_unknown=True)


def test_the_time_may_stand_in_another_group() -> None:
    """MDF 4.2 by columns: asammdf reads such files and writes none."""
    own = SimpleNamespace(flags=0, cg_master_index=None)
    other = SimpleNamespace(flags=1 << 3, cg_master_index=0)
    clock = SimpleNamespace(sync_type=1)
    mdf = SimpleNamespace(
        masters_db={0: 0},
        groups=[
            SimpleNamespace(channel_group=own, channels=[clock]),
            SimpleNamespace(channel_group=other, channels=[SimpleNamespace()]),
        ],
    )
    check_time_axis(Path("rig.mf4"), mdf, 1, "speed")
    clock.sync_type = 2
    with pytest.raises(InputError, match="channel 'speed': is recorded over an angle"):
        check_time_axis(Path("rig.mf4"), mdf, 1, "speed")


@pytest.mark.parametrize(
    ("conversion", "expected"),
    [
        ({"val_0": 255.0, "text_0": b"SNA"}, [0.0, 100.0, np.nan]),
        ({"lower_0": 90.0, "upper_0": 255.0, "text_0": b"SNA"}, [0.0, np.nan, np.nan]),
        (
            {"val_0": 255.0, "text_0": b"SNA", "default_addr": {"a": 0.5, "b": -10.0}},
            [-10.0, 40.0, np.nan],
        ),
        ({"val_0": 255.0, "text_0": b"SNA", "default_addr": b"other"}, [np.nan] * 3),
    ],
)
def test_labels_are_bad_samples(
    tmp_path: Path, conversion: dict[str, Any], expected: list[float]
) -> None:
    values = np.array([0, 100, 255], np.uint8)
    speed = channel("motor_speed_rad_s", values, T[:3], conversion=conversion)
    mapping = "signals: {motor_speed_rad_s: {column: motor_speed_rad_s}}"
    found = read(tmp_path, [[speed]], mapping, gaps="mark").series["motor_speed_rad_s"]
    np.testing.assert_array_equal(found.value, expected)
    with pytest.raises(InputError, match="is NaN, infinite or marked invalid"):
        read_recording(tmp_path / "rig.mf4")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ([channel("spd", T, T)], "channel 'spd' is there twice"),
        (
            [channel("state", np.full(len(T), b"on"), T, encoding="utf-8")],
            "channel state: does not hold plain num",
        ),
        ([], "channel 'state': is missing; there are: spd"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path: Path, more: list[Any], said: str) -> None:
    mapping = "signals: {motor_speed_rad_s: {column: spd}, rack_force_n: {column: state}}"
    with pytest.raises(InputError, match=re.escape(said)):
        read(
            tmp_path, [[channel("spd", T, T)], more] if more else [[channel("spd", T, T)]], mapping
        )


def test_a_sum_of_channels_of_other_rates(tmp_path: Path) -> None:
    left = [channel("l", 100.0 * T, T)]
    right = [channel("r", 50.0 * T[500:5500:5], T[500:5500:5])]
    mapping = "signals: {rack_force_n: {sum: [l, r]}}"
    found = read(tmp_path, [left, right], mapping)
    force = found.series["rack_force_n"]
    seconds = (force.t_ns - START_NS) * 1e-9
    assert (seconds[0], seconds[-1]) == pytest.approx((0.5, 5.495))
    np.testing.assert_allclose(force.value, 150.0 * seconds, atol=1e-4)
    assert "added at those of one" in found.notes[-1]
    mapping = "signals: {motor_angle_rad: {sum: [l, r], counts_per_turn: 100}}"
    with pytest.raises(InputError, match="counts that begin anew cannot be put together"):
        read(tmp_path, [left, right], mapping)
    late = [channel("r", T, T + 100.0)]
    with pytest.raises(InputError, match="no time in common"):
        read(tmp_path, [left, late], "signals: {rack_force_n: {sum: [l, r]}}")


def test_a_hole_in_one_part_of_a_sum_is_not_drawn_straight(tmp_path: Path) -> None:
    kept = np.r_[0:1000, 2500:6000]
    parts = [[channel("l", np.ones(len(T)), T)], [channel("r", np.ones(len(kept)), T[kept])]]
    mapping = "signals: {rack_force_n: {sum: [l, r]}}"
    with pytest.raises(InputError, match="sample 1001, rack_force_n: a part of the sum is missing"):
        read(tmp_path, parts, mapping)
    force = read(tmp_path, parts, mapping, gaps="mark").series["rack_force_n"]
    assert np.flatnonzero(np.isnan(force.value)).tolist() == list(range(1000, 2500))


def test_of_a_simulators_events_the_last_sample_counts(tmp_path: Path) -> None:
    seconds = np.array([0.0, 1.0, 1.0, 2.0])
    one = [channel("spd", [0.0, 1.0, 5.0, 6.0], seconds)]
    mapping = "signals: {motor_speed_rad_s: {column: spd}}"
    found = read(tmp_path, [one], mapping, foreign=True).series["motor_speed_rad_s"]
    assert found.value.tolist() == [0.0, 5.0, 6.0]
    with pytest.raises(InputError, match="sample 3, channel spd: time repeats"):
        read(tmp_path, [one], mapping)
