"""What an FMU is driven with where a recording has nothing."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.fmu.described import FmuVariable
from eps_hil.fmu.fit import fit
from eps_hil.fmu.traces import unmet
from eps_hil.physics.model import load_model
from eps_hil.series import Series

MODEL = Path(__file__).parents[2] / "configs/reference_rig.yaml"


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


class Coarse:
    """A simulator that lacks a torque that one number gives; its solver's steps leave 10 microNm
    that are others for every other number."""

    step_s = 1e-3
    mapped = SimpleNamespace(start={})

    def __init__(self, start: float) -> None:
        known = FmuVariable(
            "trim", 1, "parameter", "N.m", "torque", (1.0, 0.0), start, (None, None), ""
        )
        self.fmu = SimpleNamespace(path="coarse.fmu", of=lambda *_: {"trim": known})

    def grid(self, *_: Any) -> Any:
        return np.arange(9000, dtype=np.int64) * 1_000_000

    def nothing(self, *_: Any) -> Any:
        return np.zeros((9000, 1))

    inputs = follow = nothing

    def run(self, _inputs: Any, values: Any, *_: Any) -> tuple[Any, Any]:
        swing = np.sin(2.0 * np.pi * np.arange(9000) * 1e-3)
        steps = np.random.default_rng(abs(hash(values["trim"]))).standard_normal(9000)
        return {}, (0.03 - values["trim"]) * swing + 1e-5 * steps


@pytest.mark.parametrize("start", [0.0, 0.1])
def test_a_number_that_begins_at_zero_is_fitted_as_others_are(start: float) -> None:
    simulator: Any = Coarse(start)
    found = fit(simulator, {"a": {}}, {}, load_model(MODEL), ["trim=-0.1:0.1"])
    assert found.parameters["trim"]["value"] == pytest.approx(0.03, rel=1e-3)
    assert found.after_nm < 2e-5
