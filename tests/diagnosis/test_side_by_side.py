"""The same work for many recordings: in order, and nothing that goes wrong is swallowed."""

import time

import pytest

from eps_hil.diagnosis.side_by_side import each


def test_results_come_in_the_order_of_what_was_given() -> None:
    def slower_first(k: int) -> int:
        time.sleep(0.002 * (10 - k))
        return 10 * k

    assert each(slower_first, range(10)) == [10 * k for k in range(10)]
    assert each(slower_first, []) == []


def test_what_goes_wrong_in_one_is_raised() -> None:
    with pytest.raises(ZeroDivisionError):
        each(lambda k: 1 // k, [2, 1, 0])
