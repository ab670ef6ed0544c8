"""Gains on blocks that were not fitted: against plain least squares, and what happened once."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.diagnosis.attribute.scoring import ONCE_GAIN, cross_validated

EVEN = np.arange(400) // 50 % 2 == 0


def plainly(columns: np.ndarray, residual: np.ndarray, jacobian: np.ndarray) -> float:
    """The same by ``lstsq``, a regressor at a time."""
    columns, residual = (
        one - jacobian @ np.linalg.lstsq(jacobian, one, rcond=None)[0]
        for one in (columns, residual)
    )
    gain = 0.0
    for fitted in (EVEN, ~EVEN):
        a = np.linalg.lstsq(columns[fitted], residual[fitted], rcond=None)[0]
        judged = residual[~fitted]
        gain += float(np.sum(judged**2 - (judged - columns[~fitted] @ a) ** 2))
    return gain


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), widths=st.lists(st.integers(1, 3), min_size=1, max_size=40))
def test_all_together_as_one_at_a_time(seed: int, widths: list[int]) -> None:
    rng = np.random.default_rng(seed)
    regressors = [rng.standard_normal((400, width)) for width in widths]
    jacobian = rng.standard_normal((400, 2))
    residual = rng.standard_normal(400) + regressors[0][:, 0]
    found = cross_validated(regressors, residual, jacobian, EVEN)
    for columns, (gain, coefficients) in zip(regressors, found, strict=True):
        assert gain == pytest.approx(plainly(columns, residual, jacobian), rel=1e-6, abs=1e-6)
        assert coefficients.shape == (columns.shape[1],)
    assert found[0][1][0] == pytest.approx(1.0, abs=0.5)


def test_what_the_fit_can_do_already_is_no_gain() -> None:
    rng = np.random.default_rng(1)
    jacobian = rng.standard_normal((400, 2))
    ((gain, coefficients),) = cross_validated(
        [jacobian @ np.ones((2, 1))], rng.standard_normal(400), jacobian, EVEN
    )
    assert gain == 0.0
    assert np.all(coefficients == 0.0)


def test_what_the_fit_could_still_do_hides_no_gain() -> None:
    """Half of what a column does is not orthogonal to half of another, however much there is."""
    rng = np.random.default_rng(2)
    jacobian, column = rng.standard_normal((400, 3)), rng.standard_normal((400, 1))
    refitted = 0.5 * column[:, 0] + 0.1 * rng.standard_normal(400)
    bare = refitted + jacobian @ np.array([300.0, -200.0, 500.0])
    ((of_fit, _),) = cross_validated([column], refitted, jacobian, EVEN)
    ((of_none, _),) = cross_validated([column], bare, jacobian, EVEN)
    assert of_fit > 50.0
    assert of_none == pytest.approx(of_fit, rel=1e-9)


def test_what_happened_once_counts_half() -> None:
    column = np.zeros((400, 1))
    column[60:80] = 1.0
    residual = 2.0 * column[:, 0]
    ((gain, coefficients),) = cross_validated([column], residual, np.zeros((400, 0)), EVEN)
    assert gain == pytest.approx(ONCE_GAIN * np.sum(residual**2))
    assert coefficients[0] == pytest.approx(2.0)
