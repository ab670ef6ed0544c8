"""Plots of what does not show in the torque balance: play, a belt, the torque sensor's play."""

from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.model import Model
from eps_hil.proof import manoeuvres, sensors
from eps_hil.proof.world import Instruments, World
from eps_hil.report import diagnosis_kinematics, diagnosis_page
from eps_hil.series import Series

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def diagnosed(reference_model: Model) -> Diagnosis:
    """Play between rotor and rack, and in the torque sensor."""
    world = World(simple=False, gap_rad=0.4, instruments=Instruments(sensor_play_nm=0.3))
    rng = np.random.default_rng(3)
    made: dict[str, Any] = {}
    for name, program in zip(
        ("a", "b", "c"), (*manoeuvres.training(rng), manoeuvres.holdout(rng)), strict=True
    ):
        clean = sensors.reported(world.run(program), world.instruments)
        columns = sensors.measured(clean, world.instruments, rng)
        t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
        made[name] = {key: Series(t_ns, value) for key, value in columns.items()}
    return diagnose(reference_model, {k: made[k] for k in "ab"}, {"c": made["c"]})


def _finding(diagnosed: Diagnosis, effect: str) -> dict[str, Any]:
    (found,) = (one for one in diagnosed.content["findings"] if one["effect"] == effect)
    return dict(found)


def test_play_is_a_step_of_its_own_width(diagnosed: Diagnosis) -> None:
    finding = _finding(diagnosed, "backlash")
    plot = diagnosis_kinematics.figure(diagnosed, finding)
    assert plot is not None
    dots = plot.lines[0].y
    step = np.mean(dots[plot.x > 0.05]) - np.mean(dots[plot.x < -0.05])
    assert step == pytest.approx(400.0, rel=0.03)  # mrad
    said = diagnosis_kinematics.size(finding, diagnosed.problem.model)
    assert float(said.partition(" mm")[0]) == pytest.approx(1e3 * 0.4 / 2513.0, rel=0.02)


def test_the_sensors_play_parts_rising_from_falling(diagnosed: Diagnosis) -> None:
    plot = diagnosis_kinematics.figure(diagnosed, _finding(diagnosed, "torque_sensor_hysteresis"))
    assert plot is not None
    rising, falling, *fitted = (line.y for line in plot.lines)
    assert 0.2 < np.nanmean(falling - rising) < 0.6  # twice 0.3 but for what turns inside the play
    for seen, line in zip((rising, falling), fitted, strict=True):
        assert np.sqrt(np.nanmean((seen - line) ** 2)) < 0.04


def test_before_is_the_recording_as_read(diagnosed: Diagnosis) -> None:
    """Play that was taken out of the recordings counts as gain, not as given."""
    holdout = diagnosed.content["fit"]["holdout"]
    assert holdout["baseline"]["torque_nrmse"] > 2.0 * holdout["augmented"]["torque_nrmse"]
    seen = diagnosed.content["kinematics"]
    assert seen["holdout_left_rad"] < 0.1 * seen["holdout_rms_rad"]
    page = diagnosis_page.render(diagnosed, "m.yaml")
    assert "rotor angle against rack position" in page
    assert "mm of free play" in page
