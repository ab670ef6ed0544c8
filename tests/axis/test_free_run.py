"""Force in, position out: an axis simulated over a whole record from its first state."""

from pathlib import Path

import numpy as np

from eps_hil.axis.emps import ARM_M, AxisRecord, published_model
from eps_hil.axis.free_run import free_run, write
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
