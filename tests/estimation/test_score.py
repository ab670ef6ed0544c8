"""Errors against the load cell."""

import numpy as np
import pytest

from eps_hil import growing
from eps_hil.estimation.score import MOVING_RAD_S, score
from eps_hil.estimation.stream import Trace
from eps_hil.physics.model import Model
from eps_hil.series import Series

MS = 1_000_000


def compared() -> tuple[Trace, dict[str, Series]]:
    """An estimate that is off by 3 N while moving and by 1 N at rest; the load cell has holes."""
    n = 6_000
    t_ns = np.arange(n) * MS
    speed = np.where(np.arange(n) < 2 * n // 3, 10.0, 0.0)
    force = 100.0 * np.sin(np.arange(n) * 1e-3)
    cell = force.copy()
    cell[1_990:2_040] = np.nan
    off = np.where(speed > MOVING_RAD_S, 3.0, -1.0)
    reason = np.where(np.arange(n) % 50 == 0, 1, 0)
    series = {"rack_force_n": Series(t_ns, cell), "motor_speed_rad_s": Series(t_ns, speed)}
    return Trace(t_ns, force + off, np.zeros(n), reason), series


def test_moving_and_resting_apart(reference_model: Model) -> None:
    trace, series = compared()
    found = score(trace, series, reference_model)
    assert found is not None
    assert found.rows == 5_880
    assert found.bias_moving_n == pytest.approx(3.0, abs=0.3)  # the load cell's own delay
    assert found.rmse_resting_n == pytest.approx(1.0, abs=0.3)
    assert found.rmse_overall_n**2 == pytest.approx(
        (2 * found.rmse_moving_n**2 + found.rmse_resting_n**2) / 3, rel=0.02
    )


@pytest.mark.parametrize("block", [7, 1_000, 2_000])
def test_block_by_block_it_is_the_same(
    reference_model: Model, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    trace, series = compared()
    whole = score(trace, series, reference_model)
    monkeypatch.setattr(growing, "_BLOCK", block)
    found = score(trace, series, reference_model)
    assert whole is not None
    assert found is not None
    for name in ("rmse_overall_n", "rmse_moving_n", "bias_moving_n", "rms_force_n", "rows"):
        assert getattr(found, name) == pytest.approx(getattr(whole, name), rel=1e-12)


def test_without_a_load_cell_there_is_none(reference_model: Model) -> None:
    trace, series = compared()
    del series["rack_force_n"]
    assert score(trace, series, reference_model) is None


def test_a_force_that_was_given_is_not_compared_with_itself(reference_model: Model) -> None:
    trace, series = compared()
    given = Trace(
        trace.t_ns, np.full(len(trace.t_ns), np.nan), trace.friction_torque_nm, trace.reason
    )
    assert score(given, series, reference_model) is None
