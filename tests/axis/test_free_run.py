"""Force in, position out: an axis simulated over a whole record from its first state."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from eps_hil.axis.emps import ARM_M, AxisRecord, published_model
from eps_hil.axis.free_run import (
    free_run,
    friction_apart_n,
    friction_course_n,
    replayed_rmse_mm,
    with_more_friction,
    write,
)
from eps_hil.diagnosis.data.prepare import STEP_S
from eps_hil.physics.simulate import simulate


def test_the_model_that_made_a_record_runs_along_it(tmp_path: Path) -> None:
    """Begun in motion, with a force that the controller did not ask for: only their sum acts."""
    model, time = published_model(), np.asarray(np.arange(3000) * STEP_S, dtype=np.float64)
    force = 60.0 * np.sin(2 * np.pi * 0.5 * time + 1.0) + 20.0
    nothing = np.zeros(len(time))
    run = simulate(model, time, force * ARM_M, nothing, nothing, speed_rad_s=30.0)
    pulses = np.where(time > 1.0, 25.0, 0.0)
    position = run.angle_rad * ARM_M
    record = AxisRecord("made", position, force + pulses, pulses, middle_m=0.125)
    found = free_run(record, model)
    assert found.rmse_mm < 0.05 * 1e3 * np.std(position)
    rows = np.loadtxt(write(tmp_path / "traces", record, found), delimiter=",", skiprows=1)
    np.testing.assert_allclose(rows[:, 1], found.position_m + 0.125, atol=1e-8)
    np.testing.assert_allclose(rows[:, 0], time, atol=1e-6)


def test_friction_that_a_record_has_more_of_is_told_by_direction() -> None:
    """Made with 2 N more forward and 1 N less backward, and pushed by a force that is known."""
    model, time = published_model(), np.asarray(np.arange(6000) * STEP_S, dtype=np.float64)
    own = model.friction
    other = replace(
        own,
        offset_pos_nm=own.offset_pos_nm + 2.0 * ARM_M,
        offset_neg_nm=own.offset_neg_nm - 1.0 * ARM_M,
    )
    force = 60.0 * np.sin(2 * np.pi * 0.5 * time)
    nothing = np.zeros(len(time))
    run = simulate(replace(model, friction=other), time, force * ARM_M, nothing, nothing)
    pulses = np.where(time > 3.0, 25.0, 0.0)
    record = AxisRecord("made", run.angle_rad * ARM_M, force + pulses, pulses)
    forward, backward = friction_apart_n(record, model)
    assert abs(forward - 2.0) < 0.15
    assert abs(backward + 1.0) < 0.15
    assert np.all(np.abs(friction_apart_n(record, replace(model, friction=other))) < 0.15)


def test_more_friction_is_in_newtons_at_the_axis_by_direction() -> None:
    own = published_model().friction
    more = with_more_friction(published_model(), 2.0, -1.0).friction
    assert np.isclose((more.offset_pos_nm - own.offset_pos_nm) / ARM_M, 2.0)
    assert np.isclose((more.offset_neg_nm - own.offset_neg_nm) / ARM_M, -1.0)


def test_friction_that_comes_in_mid_record_is_told_by_its_part() -> None:
    """The same axis, but 2 N more friction both ways in the second half of the record."""
    model, time = published_model(), np.asarray(np.arange(8000) * STEP_S, dtype=np.float64)
    force = 60.0 * np.sin(2 * np.pi * 0.5 * time)
    nothing = np.zeros(len(time))
    run = simulate(with_more_friction(model, 2.0, 2.0), time, force * ARM_M, nothing, nothing)
    more = 2.0 * np.sign(run.speed_rad_s) * (time < 4.0)  # taken back in the first half
    record = AxisRecord("made", run.angle_rad * ARM_M, force - more, nothing)
    first, second = friction_course_n(record, model, 2)
    assert np.all(np.abs(first) < 0.2)
    assert np.all(np.abs(np.array(second) - 2.0) < 0.2)


def test_a_replay_is_judged_in_the_records_own_positions() -> None:
    time = np.arange(1000) * STEP_S
    nothing = np.zeros(1000)
    one = AxisRecord("one", np.sin(time), nothing, nothing, middle_m=0.1)
    other = AxisRecord("other", np.sin(time[:900]) - 0.001, nothing[:900], nothing[:900], 0.103)
    assert np.isclose(replayed_rmse_mm(one, other), 2.0)
