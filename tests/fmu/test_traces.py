"""What an FMU is driven with where a recording has nothing."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.fmu.traces import unmet
from eps_hil.series import Series


def test_inputs_that_are_not_there_all_the_time_are_told() -> None:
    link = SimpleNamespace(variable=SimpleNamespace(name="u"))
    names = ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")
    simulator: Any = SimpleNamespace(mapped=SimpleNamespace(inputs=dict.fromkeys(names, link)))
    t_ns = np.arange(5000, dtype=np.int64) * 1_000_000
    series = {
        "motor_torque_nm": Series(t_ns, np.ones(5000)),
        "rack_force_n": Series(t_ns[:2000], np.ones(2000)),
        "motor_angle_rad": Series(t_ns[:4000], np.ones(4000)),
    }
    early = "rack_force_n ends 3 s before motor_torque_nm: from there on held at its last value"
    assert unmet(simulator, {"a.csv": series}) == [
        "a.csv: no torque_sensor_nm: u is driven with zero",
        f"a.csv: {early}",
        "a.csv: motor_angle_rad ends 1 s before motor_torque_nm: from there on held at its last "
        "value",
    ]


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        ({}, "needs motor_speed_rad_s or motor_angle_rad, at which the FMU is kept; it holds"),
        ({"motor_angle_rad": 9}, "motor_torque_nm and motor_angle_rad have no time in common"),
    ],
)
def test_a_recording_without_a_motion_is_refused(motion: dict[str, int], said: str) -> None:
    simulator: Any = SimpleNamespace(mapped=SimpleNamespace(inputs={}))
    t_ns = np.arange(5000, dtype=np.int64) * 1_000_000
    series = {"motor_torque_nm": Series(t_ns, np.ones(5000))}
    series |= {n: Series(t_ns + k * 1_000_000_000, np.ones(5000)) for n, k in motion.items()}
    with pytest.raises(InputError, match=f"a.csv: {said}"):
        unmet(simulator, {"a.csv": series})
