"""What differs between recordings by a constant is said; what follows the motion is not."""

import numpy as np
import pytest

from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.mismatch.between import between_recordings
from eps_hil.physics.balance import residual_nm
from eps_hil.physics.model import Model
from eps_hil.series import Series


def recording(
    model: Model,
    name: str,
    *,
    constant: float = 0.0,
    level: float = 0.0,
    drag: float = 0.0,
    mean_rad_s: float = 0.0,
    noise_nm: float = 1e-3,
) -> Prepared:
    """A weave whose torque is the model's own, and what is asked for."""
    t_ns = np.arange(20_000, dtype=np.int64) * 1_000_000
    t, rng = t_ns * 1e-9, np.random.default_rng(len(name))
    speed = mean_rad_s + 60.0 * np.cos(3.0 * t) + 20.0 * np.cos(0.7 * t)
    columns = {
        "motor_torque_nm": np.zeros(len(t)),
        "motor_speed_rad_s": speed + 0.05 * rng.standard_normal(len(t)),
        "rack_force_n": np.zeros(len(t)),
    }
    series = {key: Series(t_ns, values) for key, values in columns.items()}
    bare = prepare(name, series)
    needed, _ = residual_nm(model, bare.motion(model), None)
    lacks = constant + level * np.sign(speed) + drag * speed
    torque = bare.raw["motor_torque_nm"] - needed + lacks
    torque += noise_nm * rng.standard_normal(len(t))
    return prepare(name, {**series, "motor_torque_nm": Series(t_ns, torque)})


@pytest.mark.parametrize(
    ("kind", "said"), [("constant", "a constant torque"), ("level", "a level of friction")]
)
def test_a_constant_that_differs_is_said(reference_model: Model, kind: str, said: str) -> None:
    first = recording(reference_model, "cold", **{kind: 0.06})
    second = recording(reference_model, "warm", **{kind: -0.02})
    (told,) = between_recordings([first, second], reference_model)
    assert said in told
    assert "in cold" in told
    assert "in warm" in told


@pytest.mark.parametrize(("way", "said"), [(1.0, "speed > 0"), (-1.0, "speed < 0")])
def test_of_recordings_that_turn_one_way_it_is_said_too(
    reference_model: Model, way: float, said: str
) -> None:
    """There a constant and a level look the same."""
    first = recording(reference_model, "cold", level=0.06, mean_rad_s=100.0 * way)
    second = recording(reference_model, "warm", level=-0.02, mean_rad_s=100.0 * way)
    other = recording(reference_model, "back", level=0.02, mean_rad_s=-100.0 * way)
    (told,) = between_recordings([first, second, other], reference_model)
    assert "a constant, or a level of friction" in told
    assert said in told
    assert "back" not in told


def test_one_recording_each_way_differs_by_an_asymmetry(reference_model: Model) -> None:
    """Which is a law of the motion."""
    both = [
        recording(reference_model, name, constant=size, mean_rad_s=100.0 * np.sign(size))
        for name, size in (("there", 0.06), ("back", -0.06))
    ]
    assert between_recordings(both, reference_model) == []


def test_of_a_torque_it_is_said_although_noise_is_more(reference_model: Model) -> None:
    """A free run adds up what a balance does not show; what is less than the torque's 5 % is not"""

    def told(level: float) -> list[str]:
        both = [
            recording(reference_model, name, level=size, noise_nm=0.05)
            for name, size in (("cold", level), ("warmer", -level))
        ]
        left = np.concatenate([one.left_over(reference_model) for one in both])
        assert level**2 < 0.2 * np.mean(left**2)
        return between_recordings(both, reference_model)

    (said,) = told(4e-3)
    assert "adding up in a free run" in said
    assert "a level of friction" in said
    assert told(5e-4) == []


def test_what_follows_the_motion_is_not(reference_model: Model) -> None:
    both = [recording(reference_model, name, drag=1e-3) for name in ("one", "another")]
    assert between_recordings(both, reference_model) == []
    assert between_recordings(both[:1], reference_model) == []
