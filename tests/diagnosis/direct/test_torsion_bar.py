"""Play in the torque sensor, where the angles that show the bar's twist are noisy."""

from collections.abc import Callable

import numpy as np
import pytest

from eps_hil.diagnosis.data.prepare import Floats, Prepared, with_play
from eps_hil.diagnosis.direct.torsion_bar import sensor_play
from eps_hil.identification.butterworth import low_pass
from eps_hil.physics.model import Model

pytestmark = pytest.mark.slow

BAR_NM_PER_RAD = 105.0
N = 30_000


def recording(
    model: Model, torque_nm: Floats, play_nm: float, noise_rad: float, seed: int
) -> Prepared:
    """A bar under this torque, its sensor with play, and angles with this noise."""
    rng = np.random.default_rng(seed)
    position = low_pass(rng.standard_normal(N), 1.0) * 0.05
    wheel = torque_nm / BAR_NM_PER_RAD + model.pinion_ratio_rad_per_m * position
    reported = with_play(torque_nm, play_nm) if play_nm else torque_nm
    raw = {
        "torque_sensor_nm": reported + 0.025 * rng.standard_normal(N),
        "rack_position_m": position + 1e-6 * rng.standard_normal(N),
        "steering_wheel_angle_rad": wheel + noise_rad * rng.standard_normal(N),
    }
    noise = {
        "torque_sensor_nm": 0.025,
        "rack_position_m": 1e-6,
        "steering_wheel_angle_rad": noise_rad,
    }
    return Prepared("a", np.linspace(0.0, 1e-3 * N, N, endpoint=False), raw, noise, False)


def torque(size_nm: float, seed: int, hz: float = 1.5) -> Floats:
    slow = low_pass(np.random.default_rng(seed).standard_normal(N), hz)
    return np.asarray(size_nm * slow / np.std(slow))


@pytest.mark.parametrize(("size_nm", "noise_rad"), [(0.15, 3e-3), (0.3, 6e-3), (2.0, 1.5e-3)])
def test_noise_that_a_play_would_hold_back_is_no_play(
    reference_model: Model, size_nm: float, noise_rad: float
) -> None:
    """Hands nearly off, and angles whose noise is as large as the torque: nothing is loose."""
    for seed in range(3):
        some = [
            recording(reference_model, torque(size_nm, seed + k, 0.3), 0.0, noise_rad, seed + k)
            for k in (10, 20, 30)
        ]
        assert sensor_play(some[:2], some[2:], reference_model) is None


def test_what_a_play_loses_where_the_bar_is_moved_counts(reference_model: Model) -> None:
    """Hands off but for one lively recording: there it gains nothing, and no noise is left over."""
    for seed in range(6):
        seeds = [seed + 10 * k for k in (0, 1, 2, 10, 11)]
        torques = [0.06 * np.sign(torque(1.0, k, 0.3)) for k in seeds]
        torques[3] = torque(1.0, seeds[3], 8.0)
        some = [
            recording(reference_model, one, 0.0, 3.3e-3, k)
            for one, k in zip(torques, seeds, strict=True)
        ]
        assert sensor_play(some[:4], some[4:], reference_model) is None


@pytest.mark.parametrize("noise_rad", [1e-4, 1.5e-3])
def test_play_is_seen_through_the_same_noise(reference_model: Model, noise_rad: float) -> None:
    some = [recording(reference_model, torque(2.0, k), 0.13, noise_rad, k) for k in (10, 20, 30)]
    found = sensor_play(some[:2], some[2:], reference_model)
    assert found is not None
    seen, law = found
    assert seen.entry["play_nm"] == pytest.approx(0.13, abs=0.03)
    assert seen.entry["play_nm"] == pytest.approx(0.13, abs=seen.half_width["play_nm"])
    assert law.gain == pytest.approx(BAR_NM_PER_RAD, rel=0.01)


def test_where_the_rack_counts_from_is_no_torque(reference_model: Model) -> None:
    """A rack's zero 0.4 m away is 50 rad of twist, and nothing else."""
    some = [recording(reference_model, torque(2.0, k), 0.2, 1.5e-4, k) for k in (1, 2, 3)]
    moved = [
        one.changed(raw={**one.raw, "rack_position_m": one.raw["rack_position_m"] + 0.4})
        for one in some
    ]
    found, other = (sensor_play(each[:2], each[2:], reference_model) for each in (some, moved))
    assert found is not None
    assert other is not None
    play = found[0].entry["play_nm"]
    assert play == pytest.approx(0.2, rel=0.1)
    assert other[0].entry["play_nm"] == pytest.approx(play, rel=1e-3)


def changed(one: Prepared, name: str, how: Callable[[Floats], Floats]) -> Prepared:
    return one.changed(raw={**one.raw, name: how(one.raw[name])})


@pytest.mark.parametrize(
    ("name", "how", "play_nm"),
    [
        ("torque_sensor_nm", lambda v: -v, 0.2),
        ("torque_sensor_nm", lambda v: v + 30.0, 0.2),
        ("torque_sensor_nm", lambda v: 1000.0 * v, None),
        ("steering_wheel_angle_rad", lambda v: v - 0.3, 0.2),
        ("steering_wheel_angle_rad", lambda v: np.roll(v, 180), None),
        ("torque_sensor_nm", lambda v: 0.0 * v, None),
        ("torque_sensor_nm", lambda v: np.full_like(v, np.nan), None),
        ("rack_position_m", lambda v: 1000.0 * v, None),
    ],
)
def test_a_reading_that_is_far_off_ends_nothing(
    reference_model: Model, name: str, how: Callable[[Floats], Floats], play_nm: float | None
) -> None:
    """Sign, zero, unit, delay, a channel that is dead: the play that is there, or nothing."""
    some = [
        changed(recording(reference_model, torque(2.0, k), 0.2, 1.5e-4, k), name, how)
        for k in (1, 2, 3)
    ]
    found = sensor_play(some[:2], some[2:], reference_model)
    if play_nm is None:
        assert found is None
    else:
        assert found is not None
        assert found[0].entry["play_nm"] == pytest.approx(play_nm, rel=0.1)
