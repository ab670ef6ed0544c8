"""Which changes of a slow speed are motion."""

import numpy as np
import numpy.typing as npt
import pytest

from eps_hil.diagnosis.data.prepare import Prepared, prepare, seen_twice
from eps_hil.diagnosis.data.seen_twice import motion_hz
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

STEP_S = 1e-3


def slow_motion(seconds: float, rng: np.random.Generator) -> Floats:
    """A speed of some rad/s that changes below 3 Hz, at 1 kHz."""
    time_s = np.arange(round(seconds / STEP_S)) * STEP_S
    tones = [(one, rng.uniform(0.0, 6.0)) for one in (0.2, 0.5, 1.1, 1.9, 2.8)]
    return np.sum([np.sin(2 * np.pi * hz * time_s + phase) for hz, phase in tones], axis=0)


def noisy(speed_noise: float, share: float = 1.0) -> Prepared:
    """Recorded at 40 Hz with an angle of 0.5 mrad; ``share`` of the motion."""
    rng = np.random.default_rng(5)
    speed = share * slow_motion(60.0, rng)
    angle = np.cumsum(speed) * STEP_S
    at = np.arange(0, len(speed), 25)
    t_ns = at.astype(np.int64) * 1_000_000
    columns = {
        "motor_speed_rad_s": speed[at] + speed_noise * rng.standard_normal(len(at)),
        "motor_angle_rad": angle[at] + 5e-4 * rng.standard_normal(len(at)),
        "motor_torque_nm": np.sign(speed[at]),
    }
    return prepare("joint", {name: Series(t_ns, one) for name, one in columns.items()})


def test_noise_is_no_acceleration() -> None:
    """A derivative of what is measured at 40 Hz has three times the error of one that ends."""
    one = noisy(0.15)
    bare = one.changed(motion_hz=np.inf)
    assert not one.speed_is_derived
    assert 3.0 <= one.motion_hz <= 6.0
    assert one._acceleration_variance() < 0.1 * bare._acceleration_variance()
    true = one.thin(np.gradient(slow_motion(60.0, np.random.default_rng(5)), STEP_S)[:59_976])
    error, other = (
        np.std(each.thin(each._kinematics["acceleration"]) - true) for each in (one, bare)
    )
    assert error < 0.33 * other


def test_recordings_of_a_machine_share_one_end() -> None:
    """One that hardly moves has the same sensors, and would have a lower end of its own."""
    lively, lazy = noisy(0.05), noisy(0.05, 0.05)
    assert lazy.motion_hz < lively.motion_hz
    one, other = seen_twice([lively, lazy])
    assert one.motion_hz == other.motion_hz
    assert lazy.motion_hz < one.motion_hz <= lively.motion_hz
    assert one._acceleration_variance() == pytest.approx(other._acceleration_variance(), rel=0.2)


def test_a_clear_speed_is_motion_as_far_as_it_goes() -> None:
    assert noisy(1e-4).motion_hz > 10.0


def test_at_1_khz_and_of_an_angle_alone_nothing_is_ended() -> None:
    rng = np.random.default_rng(1)
    speed = slow_motion(20.0, rng) + 0.3 * rng.standard_normal(20_000)
    columns = {"motor_speed_rad_s": speed, "motor_angle_rad": np.cumsum(speed) * STEP_S,
               "motor_torque_nm": np.sign(speed)}  # fmt: skip
    t_ns = np.arange(20_000, dtype=np.int64) * 1_000_000
    series = {name: Series(t_ns, one) for name, one in columns.items()}
    assert prepare("fast", series).motion_hz == np.inf
    del series["motor_speed_rad_s"]
    slow = {name: Series(one.t_ns[::25], one.value[::25]) for name, one in series.items()}
    assert prepare("angle", slow).motion_hz == np.inf


@pytest.mark.parametrize("seconds", [6.0, 60.0])
def test_a_witness_that_knows_nothing_ends_nothing(seconds: float) -> None:
    rng = np.random.default_rng(2)
    speed = slow_motion(seconds, rng)
    rate = speed + 50.0 * rng.standard_normal(len(speed))
    assert motion_hz([(speed, rate)], STEP_S, 40.0) == np.inf
    assert motion_hz([(speed, -speed)], STEP_S, 40.0) == np.inf
