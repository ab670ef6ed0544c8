"""A channel that is a good part of a second off the others is told, not explained."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.data import far_off
from eps_hil.diagnosis.data.channels import channels_in_doubt, check_channels
from eps_hil.diagnosis.data.intake import RecordingError
from eps_hil.physics.model import Model
from eps_hil.series import Series

Signals = Mapping[str, Series]


@pytest.fixture(scope="module")
def recorded(record: Callable[..., Any]) -> Signals:
    (one,) = record({}, ("steps",), seconds=25.0).values()
    assert isinstance(one, Mapping)
    return one


def later(series: Signals, signal: str, seconds: float) -> Signals:
    """One channel as if its recorder had begun so much earlier."""
    one = series[signal]
    at = np.arange(len(one.value)) - round(1000 * seconds)
    return {**series, signal: Series(one.t_ns, one.value[np.clip(at, 0, len(at) - 1)])}


@pytest.mark.parametrize(
    ("signal", "seconds"),
    [
        ("rack_force_n", 1.0),
        ("rack_force_n", -1.0),
        ("motor_torque_nm", 1.0),
        ("motor_torque_nm", -1.0),
        ("rack_position_m", 1.0),
        ("rack_position_m", 0.4),
    ],
)
def test_the_channel_and_how_far_it_is_off_are_told(
    recorded: Signals, reference_model: Model, signal: str, seconds: float
) -> None:
    word = "later" if seconds > 0 else "earlier"
    said = f"{signal}: comes some {abs(seconds):.1f} s {word} than the other channels"
    with pytest.raises(RecordingError, match=said):
        check_channels({"r": later(recorded, signal, seconds)}, reference_model)


@pytest.mark.parametrize("seconds", [0.0, 1.0, -1.0])
def test_a_lone_torque_is_held_against_the_motion(reference_model: Model, seconds: float) -> None:
    """A joint or an axis without any load cell."""
    rng = np.random.default_rng(5)
    time = np.arange(30_000) * 1e-3
    lines = [(rng.uniform(0.2, 2.5), rng.uniform(0.0, 6.28)) for _ in range(8)]
    speed = np.sum([8.0 * np.cos(6.28 * f * time + p) for f, p in lines], axis=0)
    torque = 2e-4 * np.gradient(speed, 1e-3) + 0.05 * np.tanh(speed / 2.0) + 4e-4 * speed
    torque += 1e-3 * rng.standard_normal(len(time))
    t_ns = np.round(time * 1e9).astype(np.int64)
    one = {"motor_torque_nm": Series(t_ns, torque), "motor_speed_rad_s": Series(t_ns, speed)}
    if not seconds:
        check_channels({"r": one}, reference_model)
        return
    with pytest.raises(RecordingError, match=r"motor_torque_nm: comes some 1\.0 s"):
        check_channels({"r": later(one, "motor_torque_nm", seconds)}, reference_model)


def test_trusted_channels_are_only_remarked_upon(recorded: Signals, reference_model: Model) -> None:
    moved = {"r": later(recorded, "rack_force_n", 1.0)}
    (said,) = channels_in_doubt(moved, reference_model, True)
    assert "comes some 1.0 s later" in said


@pytest.mark.parametrize("seconds", [0.0, 0.02])
def test_what_physics_may_be_is_left_to_the_diagnosis(
    recorded: Signals, reference_model: Model, seconds: float
) -> None:
    late = later(recorded, "motor_torque_nm", seconds) if seconds else recorded
    check_channels({"r": late}, reference_model)


def test_a_model_that_lacks_most_of_the_torque_refuses_no_recording(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    plant = {other_rig.SPRING: 0.02, other_rig.SAT: 0.5, other_rig.STRIB: 0.1}
    check_channels(record(plant, ("sweep", "slow"), seconds=25.0), reference_model)


@pytest.mark.parametrize("seed", [2, 3, 4, 6, 11])
def test_a_short_slow_recording_is_not_explained_by_a_shift(
    record: Callable[..., Any], reference_model: Model, other_rig: Any, seed: int
) -> None:
    """Ten seconds below 0.2 Hz follow from a few numbers at some shift or other."""
    plant = {other_rig.STRIB: 0.06, other_rig.STRIB_W: 10.0}
    made = other_rig.record(other_rig.Effects(plant), "slow", seed, 1.0, 20.0)
    t_ns = np.round(made.pop("time_s") * 1e9).astype(np.int64)
    check_channels({"r": {name: Series(t_ns, one) for name, one in made.items()}}, reference_model)


@pytest.mark.parametrize("k", [0, 1, 2])
def test_all_shifts_at_once_leave_what_a_fit_of_each_leaves(k: int) -> None:
    rng = np.random.default_rng(3)
    n, most = 460, 100
    channels = [np.cumsum(rng.standard_normal(n)) for _ in range(3)]
    channels[0] += 2.0 * np.roll(channels[2], 7)
    inside = slice(most, n - most)
    fixed = np.column_stack([np.ones(n - 2 * most), rng.standard_normal(n - 2 * most)])
    told = far_off._left_of_all(channels, k, fixed, inside)
    assert len(told) == 2 * most + 1
    for by in range(-most, most + 1, 20):
        moved = [one[inside] for one in channels]
        moved[k] = channels[k][most + by : n - most + by]
        columns = np.column_stack([fixed, *moved[1:]])
        rest = moved[0] - columns @ np.linalg.lstsq(columns, moved[0], rcond=None)[0]
        assert told[most + by] == pytest.approx(np.mean(rest**2) / np.var(moved[0]), rel=1e-9)


def test_a_channel_that_others_hold_already_takes_nothing_off() -> None:
    rng = np.random.default_rng(4)
    n, most = 460, 100
    still, target = np.ones(n), rng.standard_normal(n)
    fixed = np.column_stack([np.ones(n - 2 * most)])
    told = far_off._left_of_all([target, still], 1, fixed, slice(most, n - most))
    assert told == pytest.approx([1.0] * (2 * most + 1))
