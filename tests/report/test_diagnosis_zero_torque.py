"""The picture of a sensor's constant error: what it reads with nothing on it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.proof.world import World
from eps_hil.report import diagnosis_page, diagnosis_zero_torque

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def off(diagnosed_world: Callable[[World], Diagnosis]) -> Diagnosis:
    """A torque sensor that reads 0.1 Nm too little, a motor that gives 8 mNm more than is said."""
    rig = World(simple=True)
    rig = replace(
        rig,
        hidden=rig.hidden._replace(motor_offset_nm=0.008),
        instruments=replace(rig.instruments, sensor_offset_nm=-0.1),
    )
    return diagnosed_world(rig)


@pytest.mark.parametrize(
    ("effect", "read_mnm"), [("torque_sensor_offset", -100.0), ("motor_torque_offset", -8.0)]
)
def test_windows_lie_about_what_was_found(off: Diagnosis, effect: str, read_mnm: float) -> None:
    (finding,) = (one for one in off.content["findings"] if one["effect"] == effect)
    plot = diagnosis_zero_torque.figure(off, finding)
    assert plot is not None
    low, high, windows, found = (line.y for line in plot.lines)
    assert found[0] == pytest.approx(read_mnm, rel=0.05)
    assert np.median(windows) == pytest.approx(read_mnm, rel=0.05)
    assert len(windows) >= 5
    assert np.all((low < found) & (found < high))


def test_the_page_draws_both(off: Diagnosis) -> None:
    page = diagnosis_page.render(off, "rig.yaml")
    for effect in ("torque_sensor_offset", "motor_torque_offset"):
        assert f'"name": "zero-{effect}"' in page
    assert page.count("nothing drives the sensor") == 2


def test_without_windows_there_is_no_picture(off: Diagnosis) -> None:
    finding = off.content["findings"][0]
    short = [one.cut(0, 1600) for one in off.problem.recordings]
    problem = off.problem.__class__(short, off.problem.model)
    assert diagnosis_zero_torque.figure(replace(off, problem=problem, judged=[]), finding) is None
