"""Recordings of two machines in one call are told, not diagnosed; physics that differs is not."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.data.channels import channels_in_doubt, check_channels
from eps_hil.diagnosis.data.intake import RecordingError
from eps_hil.diagnosis.data.one_machine import check_one_machine
from eps_hil.identification.prepare import prepare
from eps_hil.physics.model import Model
from eps_hil.series import Series


def driven(inertia: float, seed: int, spring: float = 0.0) -> Mapping[str, Series]:
    """A rotor that some sines turn, against friction."""
    rng = np.random.default_rng(seed)
    t = np.arange(20_000) * 1e-3
    lines = [(rng.uniform(0.3, 3.0), rng.uniform(0.0, 6.28)) for _ in range(6)]
    angle = np.sum([8.0 / (1 + f) * np.sin(6.28 * f * t + p) for f, p in lines], axis=0)
    speed = np.gradient(angle, 1e-3)
    torque = inertia * np.gradient(speed, 1e-3) + 0.05 * np.tanh(speed / 2.0) + 4e-4 * speed
    torque += spring * angle + 2e-3 * rng.standard_normal(len(t))
    t_ns = np.round(t * 1e9).astype(np.int64)
    return {"motor_torque_nm": Series(t_ns, torque), "motor_speed_rad_s": Series(t_ns, speed)}


def test_another_inertia_is_another_machine(reference_model: Model) -> None:
    both = {"a": driven(2.0e-4, 1), "b": driven(3.2e-4, 2)}
    said = r"another machine than a: the inertia at the rotor is 0.00032 kg m², there 0.0002"
    with pytest.raises(RecordingError, match=said) as refused:
        check_channels(both, reference_model)
    assert refused.value.recording == "b"
    (trusted,) = channels_in_doubt(both, reference_model, True)
    assert "another machine" in trusted


@pytest.mark.parametrize("spring", [0.0, 0.01, 0.05])
def test_a_spring_that_one_of_them_has_is_no_other_inertia(spring: float) -> None:
    check_one_machine([prepare("a", driven(2e-4, 1)), prepare("b", driven(2e-4, 2, spring))])


@pytest.mark.parametrize("missing", ["nothing", "much"])
def test_physics_that_one_of_them_has_is_left_to_the_diagnosis(
    record: Callable[..., Any], reference_model: Model, other_rig: Any, missing: str
) -> None:
    plant = {other_rig.STRIB: 0.1, other_rig.SAT: 0.5} if missing == "much" else {}
    here = record({}, ("steps", "sweep"), seconds=20.0)
    check_channels({**here, **record(plant, ("weave", "slow"), seconds=20.0)}, reference_model)


def test_an_assistance_that_follows_the_driver_is_no_balance() -> None:
    """Its law, which a regression finds in place of one, has an inertia of its own: a lead."""
    other = dict(driven(2e-4, 2))
    speed = other["motor_speed_rad_s"]
    acceleration = np.gradient(speed.value, 1e-3)
    rng = np.random.default_rng(5)
    balance = 2e-4 * acceleration + 0.05 * np.tanh(speed.value / 2.0) + 4e-4 * speed.value
    sensor = balance / (0.03 + 0.07) + 1e-3 * rng.standard_normal(len(speed.value))
    torque = 0.07 * sensor + 2e-5 * acceleration
    assisted = {
        **other,
        "motor_torque_nm": Series(speed.t_ns, torque),
        "torque_sensor_nm": Series(speed.t_ns, sensor),
    }
    plain = {**driven(2e-4, 1)}
    still = np.zeros(len(speed.value))
    plain["torque_sensor_nm"] = Series(speed.t_ns, still + 1e-3 * rng.standard_normal(len(still)))
    check_one_machine([prepare("a", plain), prepare("b", assisted)])
