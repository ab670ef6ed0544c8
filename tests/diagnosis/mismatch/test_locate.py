"""Where a mismatch is: intervals of signals that hold more of it than of the time."""

import numpy as np
import numpy.typing as npt
import pytest

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.mismatch.locate import Region, coordinates, where

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


def test_what_happens_at_both_ends_is_at_both(problem: Problem) -> None:
    values = coordinates(problem)["rack_position_m"]
    end = 0.8 * min(-float(np.min(values)), float(np.max(values)))
    left, right = _at_the_rack(problem, np.abs(values) > end)
    assert (left.low, left.high) == (-right.high, -right.low)
    assert end <= right.low < end + 0.1 * np.ptp(values)
    assert left.share + right.share > 0.8
    (one_end,) = _at_the_rack(problem, values > end)
    assert one_end.low > 0.0


def _at_the_rack(problem: Problem, there: npt.NDArray[np.bool_]) -> list[Region]:
    found = where(problem, there.astype(float))
    return [one for one in found if one.signal == "rack_position_m"]


def test_a_time_is_a_place_only_for_what_goes_with_time(problem: Problem) -> None:
    early = (coordinates(problem)["time_s"] < 2.5).astype(float)
    assert where(problem, early)[0].signal == "time_s"
    assert "time_s" not in [one.signal for one in where(problem, early, over_time=False)]


def test_nothing_is_nowhere(problem: Problem) -> None:
    assert where(problem, np.zeros(len(problem.scale))) == []
