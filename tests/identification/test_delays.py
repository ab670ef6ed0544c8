"""Delays for the model file from what a fit says of differences."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eps_hil.identification.delays import Timing, clocked_by_angle, of_angle, timing
from eps_hil.identification.least_squares import Fit
from eps_hil.identification.state import Parameter, State
from eps_hil.physics.model import Delays, load_model

MODEL = load_model(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")
FILE = Delays(motor_speed=0.004, motor_torque=0.001, motor_angle=0.007)


def timed(found: Delays, before: Delays = FILE) -> Timing:
    """With a torsion bar whose delay against the motion is sure, and no skew of the angle."""
    state = State(replace(MODEL, delays_s=found))
    parameters = (Parameter("delays_s.torque_sensor", "s", 0.006, 2e-4),)
    fit = Fit(state, parameters, np.array([[1e-10]]), (), 30)
    return timing(fit, None, before, 2.0, 3e-5, "kept")


def test_the_angles_own_delay_outlives_recordings_without_an_angle() -> None:
    """It was lost, and the written model took the angle to be as late as the speed."""
    found = timed(replace(FILE, motor_speed=0.005))
    assert found.delays.motor_speed == pytest.approx(0.005)
    assert found.delays.motor_angle == 0.007
    assert found.estimates["motor_angle"].status == "kept"
    assert timed(FILE, replace(FILE, motor_angle=None)).delays.motor_angle is None


def test_of_an_angle_alone_the_angles_delay_is_found() -> None:
    """It was written as the speed's."""
    start = clocked_by_angle(FILE)
    assert (start.motor_speed, start.motor_angle) == (0.007, None)
    found = of_angle(timed(replace(start, motor_speed=0.0065), start), FILE, "kept")
    assert found.delays.motor_angle == pytest.approx(0.0065)
    assert found.delays.motor_speed == 0.004
    assert found.estimates["motor_angle"].status == "identified"
    assert found.estimates["motor_angle"].from_model == 0.007
    assert found.estimates["motor_speed"].status == "kept"
    assert list(found.skews) == ["motor_angle_minus_torque_sensor"]
