"""Delays in the joint fit, where noise is most of a sensitivity."""

from dataclasses import replace

import numpy as np
import pytest

from eps_hil.diagnosis.balance.baseline import HOLD, TIMING
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.balance.spread import less_noise
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.physics.model import Model
from eps_hil.proof import manoeuvres, sensors
from eps_hil.proof.world import Instruments, World
from eps_hil.series import Series


@pytest.fixture(scope="module")
def problem(reference_model: Model) -> Problem:
    """Speed 2 ms later than the model says, with five times the usual noise."""
    rng, rig = np.random.default_rng(2), World(simple=True)
    rig = replace(rig, instruments=Instruments(speed_late_s=2e-3, noise=5.0))
    made = []
    for name, program in (
        ("weave", manoeuvres.weave(rng, 20.0)),
        ("sweep", manoeuvres.sweep(rng, 20.0)),
    ):
        clean = sensors.reported(rig.run(program), rig.instruments)
        columns = sensors.measured(clean, rig.instruments, rng)
        t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
        made.append(prepare(name, {key: Series(t_ns, one) for key, one in columns.items()}))
    return Problem(made, reference_model)


@pytest.mark.parametrize("held", [0.0, 5.0])
def test_a_fit_of_a_delay_does_not_end_on_the_way(problem: Problem, held: float) -> None:
    """Wherever it begins, and wherever the sensitivity to the motor's hold was first taken."""
    problem.columns.clear()
    problem.at = {HOLD: held}
    start = [{"effect": "speed_sensor_delay", "delay_s": 0.0}]
    found = fit(problem, start, own={**dict(TIMING), HOLD: held})
    delay_s, half = found.entries[0]["delay_s"], found.half_width[0, "delay_s"]
    assert abs(delay_s - 2e-3) < half < 1e-3
    for other in (1e-3, 3e-3):  # no fit that begins elsewhere is better
        there = fit(problem, [{**start[0], "delay_s": other}], own=dict(TIMING))
        assert there.entries[0]["delay_s"] == pytest.approx(delay_s, abs=2e-4)
        assert there.cost > found.cost - 2.0


def test_no_direction_loses_all_of_its_curvature() -> None:
    normal = np.array([[4.0, 1.9], [1.9, 1.0]])
    np.testing.assert_array_equal(less_noise(normal, np.zeros(2)), normal)
    some = less_noise(normal, np.array([0.1, 0.0]))
    np.testing.assert_allclose(some, normal - np.diag([0.1, 0.0]))
    for noise in ([3.0, 0.9], [1e6, 0.0], [4.0, 1.0]):
        assert np.linalg.eigvalsh(less_noise(normal, np.array(noise)))[0] > 0.0
