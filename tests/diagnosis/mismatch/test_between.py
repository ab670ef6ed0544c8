"""What differs between recordings by a constant is said; what follows the motion is not."""

import numpy as np
import pytest

from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.mismatch.between import between_recordings
from eps_hil.physics.balance import residual_nm
from eps_hil.physics.model import Model
from eps_hil.series import Series


def recording(
    model: Model, name: str, constant: float = 0.0, level: float = 0.0, drag: float = 0.0
) -> Prepared:
    """A weave whose torque is the model's own, and what is asked for."""
    t_ns = np.arange(20_000, dtype=np.int64) * 1_000_000
    t, rng = t_ns * 1e-9, np.random.default_rng(len(name))
    speed = 60.0 * np.cos(3.0 * t) + 20.0 * np.cos(0.7 * t)
    columns = {
        "motor_torque_nm": 1e-3 * rng.standard_normal(len(t)),
        "motor_speed_rad_s": speed + 0.05 * rng.standard_normal(len(t)),
        "rack_force_n": np.zeros(len(t)),
    }
    series = {key: Series(t_ns, values) for key, values in columns.items()}
    bare = prepare(name, series)
    needed, _ = residual_nm(model, bare.motion(model), None)
    lacks = constant + level * np.sign(speed) + drag * speed
    torque = bare.raw["motor_torque_nm"] - needed + lacks
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


def test_what_follows_the_motion_is_not(reference_model: Model) -> None:
    both = [recording(reference_model, name, drag=1e-3) for name in ("one", "another")]
    assert between_recordings(both, reference_model) == []
    assert between_recordings(both[:1], reference_model) == []
