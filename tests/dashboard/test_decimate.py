"""Least and greatest of each pixel, and values at instants."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.dashboard.decimate import HOLD_NS, at_instants, least_and_greatest

MS = 1_000_000


def pairs(t_ms: list[int], value: list[float], bucket_ms: int, n: int) -> list[list[float]]:
    t_ns = np.array(t_ms, np.int64) * MS
    found = least_and_greatest(t_ns, np.array(value), 0, bucket_ms * MS, n)
    return found.reshape(-1, 2).tolist()


def test_a_bucket_gives_its_least_and_greatest_in_the_order_of_its_motion() -> None:
    t_ms = list(range(8))
    assert pairs(t_ms, [1, 5, 0, 2, 9, 3, 7, 4], 4, 2) == [[0, 5], [9, 3]]


@given(st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=200), st.integers(1, 50))
def test_no_peak_is_lost(value: list[float], bucket_ms: int) -> None:
    n = -(-len(value) // bucket_ms)
    found = np.array(pairs(list(range(len(value))), value, bucket_ms, n))
    for k in range(n):
        own = value[k * bucket_ms : (k + 1) * bucket_ms]
        assert sorted(found[k]) == [min(own), max(own)]


def test_what_comes_slowly_is_held_and_what_stopped_is_a_gap() -> None:
    found = np.array(pairs([0, 20], [1.0, 2.0], 10, 20))
    assert found[:3, 0].tolist() == [1.0, 1.0, 2.0]
    held = 2 + HOLD_NS // (10 * MS)
    assert np.all(found[3:held] == 2.0)
    assert np.all(np.isnan(found[held + 1 :]))


def test_before_the_first_sample_and_where_all_are_bad_there_is_a_gap() -> None:
    found = np.array(pairs([20, 21, 30, 31], [np.nan, np.nan, 1.0, np.nan], 10, 4))
    assert np.isnan(found[:3]).all()
    assert found[3].tolist() == [1.0, 1.0]


def test_nothing_at_all() -> None:
    assert np.isnan(least_and_greatest(np.empty(0, np.int64), np.empty(0), 0, MS, 3)).all()
    assert len(least_and_greatest(np.empty(0, np.int64), np.empty(0), 0, MS, 0)) == 0


def test_values_at_instants_are_linear_and_never_across_a_gap() -> None:
    t_ns = np.array([0, 10, 500], np.int64) * MS
    at_ns = np.array([-1, 0, 5, 10, 200, 500, 501], np.int64) * MS
    found = at_instants(t_ns, np.array([0.0, 2.0, 4.0]), at_ns)
    assert found[1:4] == pytest.approx([0.0, 1.0, 2.0])
    assert np.isnan(found[[0, 4, 6]]).all()
    assert np.isnan(at_instants(t_ns[:1], np.zeros(1), at_ns)).all()
