"""A torque of one recording that is a second off, where only the model's balance shows it."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance.late_channel import late_channel, late_channels
from eps_hil.diagnosis.data.channels import check_channels
from eps_hil.diagnosis.data.intake import RecordingError
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Model
from eps_hil.series import Series

pytestmark = pytest.mark.slow

Signals = Mapping[str, Series]


def later(series: Signals, signal: str, seconds: float) -> Signals:
    one = series[signal]
    at = np.clip(np.arange(len(one.value)) - round(1000 * seconds), 0, len(one.value) - 1)
    return {**series, signal: Series(one.t_ns, one.value[at])}


@pytest.fixture(scope="module")
def recorded(record: Callable[..., Any]) -> Mapping[str, Signals]:
    made = record({}, ("steps", "weave", "sweep"), seconds=25.0)
    assert isinstance(made, Mapping)
    return made


@pytest.mark.parametrize("manoeuvre", ["steps", "weave", "sweep"])
@pytest.mark.parametrize("seconds", [1.0, -0.4])
def test_a_torsion_bar_whose_recorder_began_at_another_time(
    recorded: Mapping[str, Signals], reference_model: Model, manoeuvre: str, seconds: float
) -> None:
    (one,) = (each for name, each in recorded.items() if name.startswith(manoeuvre))
    moved = later(one, "torque_sensor_nm", seconds)
    check_channels({"r": moved}, reference_model)  # nothing is seen without the balance
    found = late_channel(prepare("r", moved), reference_model)
    assert found is not None
    assert found[0] == "torque_sensor_nm"
    assert found[1] == pytest.approx(seconds, abs=0.06)


def test_it_is_told_of_one_recording_of_two(
    recorded: Mapping[str, Signals], reference_model: Model
) -> None:
    one, two, kept = recorded
    both = {one: recorded[one], two: later(recorded[two], "torque_sensor_nm", 1.0)}
    with pytest.raises(RecordingError, match=r"torque_sensor_nm comes some 1\.0 s later") as told:
        diagnose(reference_model, both, {kept: recorded[kept]})
    assert told.value.recording == two
    ready = [prepare(name, each) for name, each in both.items()]
    (said,) = late_channels(ready, reference_model, trusted=True)
    assert said.startswith(f"{two}: torque_sensor_nm comes some 1.0 s later")


PHYSICS = {
    "nothing": {},
    "gain": {"EM_GAIN": 0.8},
    "spring, saturation, stribeck": {"SPRING": 0.02, "SAT": 0.5, "STRIB": 0.1},
}


@pytest.mark.parametrize("missing", list(PHYSICS))
@pytest.mark.parametrize("late_ms", [0, 30])
def test_missing_physics_is_no_shift(
    record: Callable[..., Any], other_rig: Any, reference_model: Model, missing: str, late_ms: int
) -> None:
    plant = {getattr(other_rig, name): value for name, value in PHYSICS[missing].items()}
    for name, one in record(plant, ("steps", "weave", "sweep", "slow"), seconds=25.0).items():
        ready: Prepared = prepare(name, later(one, "motor_torque_nm", 1e-3 * late_ms))
        assert late_channel(ready, reference_model) is None
