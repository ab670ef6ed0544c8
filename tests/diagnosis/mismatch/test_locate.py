"""Where a mismatch is: intervals of signals that hold more of it than of the time."""

import numpy as np
import pytest

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.mismatch.locate import coordinates, where

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("signal", ["motor_speed_rad_s", "rack_force_n"])
def test_energy_is_where_its_signal_is(problem: Problem, signal: str) -> None:
    values = coordinates(problem)[signal]
    low, high = np.quantile(values, [0.6, 0.9])
    inside = (values > low) & (values < high)
    found = where(problem, inside.astype(float))[0]
    assert found.signal == signal
    assert found.low == pytest.approx(low, abs=0.1 * np.ptp(values))
    assert found.high == pytest.approx(high, abs=0.1 * np.ptp(values))
    assert found.share > 0.8


def test_a_time_is_a_place_only_for_what_goes_with_time(problem: Problem) -> None:
    early = (coordinates(problem)["time_s"] < 2.5).astype(float)
    assert where(problem, early)[0].signal == "time_s"
    assert "time_s" not in [one.signal for one in where(problem, early, over_time=False)]


def test_nothing_is_nowhere(problem: Problem) -> None:
    assert where(problem, np.zeros(len(problem.scale))) == []
