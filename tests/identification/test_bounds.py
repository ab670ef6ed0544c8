"""A start of a bounded fit, from whatever another fit found."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from eps_hil.identification.bounds import inside

LOW, HIGH = np.array([0.0, -1.0, -np.inf, 2.0]), np.array([1.0, 1.0, 5.0, np.inf])


@pytest.mark.parametrize(
    "start", [[-3.0, 9.0, 7.0, -1e9], [0.0, 1.0, 5.0, 2.0], [0.5, 0.0, -1e6, 1e6], [1e9] * 4]
)
def test_a_start_is_strictly_inside(start: list[float]) -> None:
    at = inside(start, LOW, HIGH)
    assert np.all(at > LOW)
    assert np.all(at < HIGH)
    least_squares(lambda x: x - 0.5, at, bounds=(LOW, HIGH))


def test_a_start_inside_stays() -> None:
    np.testing.assert_array_equal(inside([0.5, 0.0, 0.0, 3.0], LOW, HIGH), [0.5, 0.0, 0.0, 3.0])
