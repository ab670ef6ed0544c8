"""Stage 0 on signals whose faults are known."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.data.quality import Channel, finding, look_at, remarks
from eps_hil.series import Series

T = np.arange(0.0, 20.0, 1e-3)
SPEED = 40.0 * np.sin(2 * np.pi * 0.4 * T)
ANGLE = -40.0 / (2 * np.pi * 0.4) * np.cos(2 * np.pi * 0.4 * T)


def seen(values: npt.NDArray[np.float64], keep: Any = slice(None)) -> Channel:
    """Stage 0 of a motor torque with these values beside a moving rotor."""
    t_ns = np.round(T * 1e9).astype(np.int64)
    noise = np.random.default_rng(1).standard_normal((3, len(T)))
    series = {
        "motor_torque_nm": Series(t_ns[keep], values[keep]),
        "motor_speed_rad_s": Series(t_ns, SPEED + 0.2 * noise[0]),
        "motor_angle_rad": Series(t_ns, ANGLE + 2e-3 * noise[1]),
    }
    return look_at("r", series).channels[0]


def torque(noise: float = 0.003, quantum: float = 0.002) -> npt.NDArray[np.float64]:
    clean = 0.4 * np.sin(2 * np.pi * 0.4 * T)
    noisy = clean + noise * np.random.default_rng(2).standard_normal(len(T))
    return np.asarray(np.round(noisy / quantum) * quantum)


def test_a_good_channel_has_no_flag() -> None:
    one = seen(torque())
    assert one.flags == []
    assert one.rate_hz == pytest.approx(1000.0)
    assert one.quantum == pytest.approx(0.002, rel=1e-6)
    assert one.noise == pytest.approx(0.003, rel=0.1)
    assert one.jitter_s < 1e-9


def test_no_channel_of_a_good_recording_is_flagged(record: Callable[..., Any]) -> None:
    for name, series in record({}, ("sweep", "slow", "steps"), seconds=12.0).items():
        for channel in look_at(name, series).channels:
            assert channel.flags == [], (name, channel.signal, channel.flags)


def test_a_clipped_channel_is_flagged_where_it_clips() -> None:
    one = seen(np.clip(torque(), -0.35, 0.35))
    assert "clipped" in one.flags
    for start, end in one.clipped:
        middle = np.argmin(np.abs(T - 0.5 * (start + end)))
        assert abs(0.4 * np.sin(2 * np.pi * 0.4 * T[middle])) > 0.34


@pytest.mark.parametrize(
    "values",
    [
        np.full(len(T), 13.89),
        13.89 + 0.01 * (np.arange(len(T)) % 400 < 100),  # between two steps of its message
        np.where(T < 0.1, 0.0, 13.89),  # the first frames come before the set-point
        np.minimum(13.89, 2.0 * T),  # driven there, and held
    ],
)
def test_a_channel_that_is_held_is_not_clipped(values: npt.NDArray[np.float64]) -> None:
    assert seen(values).clipped == ()


def test_a_stuck_channel_is_flagged() -> None:
    values = torque()
    values[5100:6300] = values[5100]
    one = seen(values)
    assert one.flags == ["stuck"]
    ((start, end),) = one.stuck
    assert [start, end] == pytest.approx([5.1, 6.299], abs=0.01)


def test_lost_frames_and_gaps_are_counted() -> None:
    keep = np.ones(len(T), dtype=bool)
    keep[1000:19000:100] = False
    keep[7000:7300] = False
    one = seen(torque(), keep)
    assert one.lost_frames == 300 + 180 - 3
    assert len(one.gaps) == 1
    assert list(one.gaps[0]) == pytest.approx([6.999, 7.3], abs=0.002)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.1])
def test_late_stamps_are_no_lost_frames(share: float) -> None:
    """As a busy receiver stamps them: up to nearly half a step early or late."""
    rng = np.random.default_rng(1)
    late = np.clip(2e-4 * rng.standard_normal(len(T)), -4.5e-4, 4.5e-4)
    keep = rng.random(len(T)) >= share
    t_ns = np.round((T + late) * 1e9).astype(np.int64)[keep]
    one = look_at("r", {"motor_torque_nm": Series(t_ns, torque()[keep])}).channels[0]
    lost = np.count_nonzero(~keep)
    assert one.lost_frames == pytest.approx(lost, rel=0.1, abs=20)


def test_frames_that_were_held_up_and_come_at_once_are_not_lost() -> None:
    """A busy receiver: every second, ten stamps as late as the last of them."""
    late = T.copy()
    for first in range(1000, len(T) - 10, 1000):
        late[first : first + 10] = T[first + 9] + 1e-5 * np.arange(10)
    t_ns = np.round(late * 1e9).astype(np.int64)
    one = look_at("r", {"motor_torque_nm": Series(t_ns, torque())}).channels[0]
    assert one.lost_frames <= 5


def test_stamps_that_stand_twice_are_looked_at_too() -> None:
    t_ns = np.round(np.floor(T * 250.0) / 250.0 * 1e9).astype(np.int64)
    one = look_at("r", {"motor_torque_nm": Series(t_ns, torque())}).channels[0]
    assert one.lost_frames == 0


@pytest.mark.parametrize("kind", ["each step its own", "two or three of a fast clock's"])
def test_an_uneven_logger_lost_no_frames(kind: str) -> None:
    rng = np.random.default_rng(3)
    if kind == "each step its own":
        steps = 1e-3 * (0.7 + rng.exponential(0.6, 20_000))
    else:
        steps = 1e-3 * rng.choice([2, 3, 4, 5], 20_000, p=[0.68, 0.29, 0.02, 0.01])
    t_ns = np.round(np.cumsum(steps) * 1e9).astype(np.int64)
    look = look_at("r", {"motor_torque_nm": Series(t_ns, np.sin(1e-9 * t_ns))})
    assert look.channels[0].lost_frames == 0
    assert finding([look]) is None
    assert remarks([look]) == [
        "r: logged unevenly, by no regular clock (motor_torque_nm): frames lost cannot be counted"
    ]


@pytest.mark.parametrize("jitter", [0.1, 0.2])
def test_frames_lost_beside_heavy_jitter_are_counted(jitter: float) -> None:
    """A stamp that is late by more than half a step is given back by the next: no hole."""
    rng = np.random.default_rng(4)
    number = np.flatnonzero(rng.uniform(size=60_000) > 0.01)
    stamps = np.sort(number + jitter * rng.standard_normal(len(number)))
    t_ns = np.round(1e6 * stamps).astype(np.int64) + 10**9
    look = look_at("r", {"motor_torque_nm": Series(t_ns, np.sin(1e-9 * t_ns))})
    assert look.channels[0].lost_frames == pytest.approx(60_000 - len(number), rel=0.05)
    assert remarks([look]) == []


def test_a_few_holes_of_a_regular_clock_are_counted_and_not_uneven() -> None:
    keep = np.ones(len(T), dtype=bool)
    for first in range(500, len(T), 700):
        keep[first : first + 20] = False
    t_ns = np.round(T * 1e9).astype(np.int64)[keep]
    look = look_at("r", {"motor_torque_nm": Series(t_ns, torque()[keep])})
    assert look.channels[0].lost_frames == pytest.approx(np.sum(~keep), abs=20)
    assert remarks([look]) == []


def test_jitter_is_measured() -> None:
    t_ns = np.round((T + 5e-5 * np.random.default_rng(0).standard_normal(len(T))) * 1e9)
    series = {"motor_torque_nm": Series(t_ns.astype(np.int64), torque())}
    one = look_at("r", series).channels[0]
    assert one.jitter_s == pytest.approx(5e-5 * np.sqrt(2), rel=0.1)


def test_dropped_frames_become_a_finding_where_they_matter() -> None:
    t_ns = np.round(T * 1e9).astype(np.int64)
    many, few = np.ones(len(T), dtype=bool), np.ones(len(T), dtype=bool)
    many[::40], few[::400] = False, False
    for keep, said in ((many, True), (few, False)):
        series = {"motor_torque_nm": Series(t_ns[keep], torque()[keep])}
        found = finding([look_at("r", series)])
        assert (found is not None) is said
    assert found is None


def test_what_we_published_ourselves_before_the_rig_began_is_no_loss() -> None:
    """As in a demo's log: the service says once a second that it has no input, then estimates."""
    t_ns = np.round(T * 1e9).astype(np.int64)
    before_ns = t_ns[0] - np.arange(22, 0, -1) * 1_000_000_000
    ours_ns = np.concatenate([before_ns, t_ns])
    ours = Series(ours_ns, np.sin(1e-9 * ours_ns))
    series = {
        "motor_torque_nm": Series(t_ns, torque()),
        "rack_force_estimate_n": ours,
        "friction_torque_nm": ours,
    }
    look = look_at("bus.log", series)
    assert look.channels[1].lost_frames > 20_000  # the same counting, of what nobody reads
    assert finding([look]) is None
    lossy = np.arange(len(T)) % 40 != 0
    series["motor_torque_nm"] = Series(t_ns[lossy], torque()[lossy])
    found = finding([look_at("bus.log", series)])
    assert found is not None
    assert "motor_torque_nm" in found["summary"]
    assert "estimate" not in found["summary"]
    assert found["parameters"]["count"]["value"] == pytest.approx(np.sum(~lossy), abs=2)


def test_what_is_wrong_is_barred(record: Callable[..., Any]) -> None:
    (series,) = record({}, ("weave",), seconds=10.0).values()
    force = series["rack_force_n"]
    clipped = {**series, "rack_force_n": Series(force.t_ns, np.clip(force.value, -400, 400))}
    for one, expected in ((series, 0.0), (clipped, 0.3)):
        barred = look_at("r", one).barred(prepare("r", one))
        assert np.mean(barred) >= expected
        assert expected > 0 or not barred.any()


@pytest.mark.parametrize("hole", [(7000, 7300), (0, 300), (len(T) - 300, len(T))])
def test_a_hole_in_one_column_is_a_gap(hole: tuple[int, int]) -> None:
    """Marked as bad samples or not there at all, within the signal or at its ends."""
    values = torque()
    values[slice(*hole)] = np.nan
    one = seen(values)
    assert one.flags == ["gaps", "bad_samples"]
    ((start, end),) = one.gaps
    assert start == pytest.approx(max(T[hole[0]] - 1e-3, 0.0), abs=1e-6)
    assert end == pytest.approx(min(T[hole[1] - 1] + 1e-3, T[-1]), abs=1e-6)


def test_bad_samples_that_can_be_bridged_are_no_gap() -> None:
    values = torque()
    for start in range(1000, 19000, 100):
        values[start : start + 15] = np.nan
    slow = np.full(len(T), np.nan)
    slow[::50] = torque()[::50]  # a column of 20 Hz in a table of 1 kHz
    assert seen(values).gaps == ()
    assert seen(slow).gaps == ()


def test_bad_samples_do_not_hide_what_is_stuck() -> None:
    t_ns = np.round(T * 1e9).astype(np.int64)
    held = ANGLE + 2e-3 * np.random.default_rng(1).standard_normal(len(T))
    held[5100:6300] = held[5100]
    speed = SPEED.copy()
    speed[5500:5510] = np.nan
    series = {"motor_angle_rad": Series(t_ns, held), "motor_speed_rad_s": Series(t_ns, speed)}
    assert look_at("r", series).channels[0].stuck


@pytest.mark.parametrize(("signal", "counts"), [("rack_force_n", True), ("vehicle_speed", False)])
def test_a_gap_bars_only_where_the_balance_needs_the_signal(
    record: Callable[..., Any], signal: str, counts: bool
) -> None:
    (series,) = record({}, ("weave",), seconds=10.0).values()
    whole = series["rack_force_n"]
    values = whole.value.copy()
    values[4000:5000] = np.nan
    holed = {**series, signal: Series(whole.t_ns, values)}
    one, look = prepare("r", holed), look_at("r", holed)
    inside = (one.thin_time_s > 3.9) & (one.thin_time_s < 5.1)
    np.testing.assert_array_equal(look.barred(one), inside & counts)
    np.testing.assert_array_equal(look.bad_at(np.array([3.8, 4.5, 5.2])), [False, counts, False])


def test_rows_lost_count_once_whatever_the_signals_rates() -> None:
    """Of a slow signal a larger share may be lost by chance; its frames are fewer than the rows."""
    step = 1_000_000
    kept = np.array([k for k in range(20_000) if k % 60 != 4])
    slow = kept[kept % 4 == 0]
    series = {
        "motor_torque_nm": Series(kept * step, np.sin(kept * 1e-2)),
        "rack_force_n": Series(slow * step, np.cos(slow * 1e-2)),
    }
    frames, share = look_at("a", series).lost
    assert frames == 20_000 - len(kept)
    assert share == pytest.approx(1 / 15, rel=0.02)


@pytest.mark.parametrize("alone", [False, True])
def test_a_hole_in_all_inputs_is_a_pause_and_in_one_a_loss(alone: bool) -> None:
    """A rig that was held up for 0.3 s sent nothing meanwhile, so nothing was lost."""
    t_ns = np.round(T * 1e9).astype(np.int64)
    keep = (T < 7.0) | (T > 7.3)
    whole = {"motor_torque_nm": torque(), "motor_speed_rad_s": 9.0 * np.cos(2.5 * T)}
    holed = {
        name: Series(t_ns[keep], value[keep]) if k == 0 or not alone else Series(t_ns, value)
        for k, (name, value) in enumerate(whole.items())
    }
    look = look_at("r", holed)
    assert look.channels[0].lost_frames == 301
    assert look.lost[0] == (301 if alone else 0)
    assert (finding([look]) is not None) == alone


def test_thousands_of_holes_are_compared_in_order() -> None:
    """One input misses every second hole of the other."""
    seconds = np.arange(0.0, 400.0, 1e-3)
    step = np.floor(seconds / 0.1).astype(int)
    rng = np.random.default_rng(2)
    series = {}
    for name, often in (("motor_torque_nm", 1), ("motor_speed_rad_s", 2)):
        hole = (seconds % 0.1 > 0.05) & (step % often == 0)
        t_ns = np.round(seconds[~hole] * 1e9).astype(np.int64)
        series[name] = Series(t_ns, rng.standard_normal(len(t_ns)))
    look = look_at("r", series)
    assert [len(one.gaps) for one in look.channels] == [4000 - 1, 2000]
    lost = look.channels[0].lost_frames
    assert look.lost[0] == pytest.approx(lost / 2, rel=0.02)


def test_stamps_in_whole_milliseconds_lose_no_frame() -> None:
    """A signal every 2.4 ms, as a robot's table has it: 2 and 3 ms apart, none missing."""
    stamps = np.round(2.37e-3 * np.arange(20_000), 3)
    one = Series(np.round(stamps * 1e9).astype(np.int64), np.sin(stamps))
    series = {"motor_angle_rad": one, "motor_torque_nm": one}
    (channel, _) = look_at("robot", series, 2513.0).channels
    assert channel.lost_frames == 0
    kept = np.delete(np.arange(20_000), np.arange(50, 20_000, 50))
    holed = {name: Series(s.t_ns[kept], s.value[kept]) for name, s in series.items()}
    (channel, _) = look_at("robot", holed, 2513.0).channels
    assert channel.lost_frames == pytest.approx(399, rel=0.1)
