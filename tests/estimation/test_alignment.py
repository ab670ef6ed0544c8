"""Fractional delays, gaps and slopes against closed forms."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.estimation.alignment import (
    RING,
    forget_noise,
    learn_noise,
    push_sample,
    read_at,
    slope,
)
from eps_hil.estimation.validity import Reason

LOST = int(Reason.MOTOR_SPEED)
EPOCH = 1_757_617_431_000_000_000


def ring(t_ns: Any, values: Any) -> tuple[Any, Any, Any]:
    stamps, data, count = np.zeros((1, RING), np.int64), np.zeros((1, RING)), np.zeros(1, np.int64)
    for t, v in zip(t_ns, values, strict=True):
        push_sample(stamps, data, count, 0, int(t), float(v))
    return stamps, data, count


@given(
    st.lists(st.integers(1, 5_000_000), min_size=3, max_size=700),
    st.floats(0.0, 1.0),
    st.floats(-1e3, 1e3),
)
def test_a_straight_line_is_read_exactly(steps: list[int], part: float, rate: float) -> None:
    t_ns = EPOCH + np.cumsum(np.array(steps, np.int64))
    values = (t_ns - EPOCH) * 1e-9 * rate
    kept = t_ns[-RING:]
    at = int(kept[0]) + round(part * int(kept[-1] - kept[0]))
    value, why = read_at(*ring(t_ns, values), 0, at, 10_000_000, LOST)
    assert why == 0
    assert value == pytest.approx((at - EPOCH) * 1e-9 * rate, abs=1e-9 * (1 + abs(rate)))


def test_a_sample_is_read_as_it_is() -> None:
    t_ns = np.arange(10) * 1_000_000
    values = np.array([0.1, 0.7, -0.3, 0.2, 0.9, 0.5, 0.6, 0.8, 0.3, 0.4])
    for k in range(10):
        assert read_at(*ring(t_ns, values), 0, int(t_ns[k]), 10**7, LOST) == (values[k], 0)


def test_held_for_a_while_then_lost() -> None:
    one = ring([0, 1_000_000], [1.0, 2.0])
    assert read_at(*one, 0, 11_000_000, 10_000_000, LOST) == (2.0, 0)
    assert read_at(*one, 0, 11_000_001, 10_000_000, LOST) == (2.0, LOST)


def test_nothing_there_and_nothing_that_old() -> None:
    assert read_at(*ring([], []), 0, 5, 10, LOST)[1] == LOST
    assert read_at(*ring([1000, 2000], [1, 2]), 0, 5, 10_000, LOST)[1] == LOST


def test_a_hole_is_a_gap() -> None:
    one = ring([0, 50_000_000], [0.0, 1.0])
    assert read_at(*one, 0, 25_000_000, 20_000_000, LOST) == (0.5, int(Reason.GAP))


def test_a_bad_sample_spoils_its_two_intervals_only() -> None:
    one = ring(np.arange(5) * 1_000_000, [0, 1, np.nan, 3, 4])
    bad = int(Reason.BAD_SAMPLE)
    said = [read_at(*one, 0, t * 500_000, 10**7, LOST)[1] for t in range(9)]
    assert said == [0, 0, 0, bad, bad, bad, 0, 0, 0]


def test_a_stamp_that_does_not_go_forward_is_refused() -> None:
    stamps, data, count = ring([1000], [1.0])
    assert not push_sample(stamps, data, count, 0, 1000, 2.0)
    assert not push_sample(stamps, data, count, 0, 999, 2.0)
    assert count[0] == 1


@given(st.floats(-50, 50), st.floats(-200, 200), st.integers(3, 40))
def test_slope_is_exact_for_a_parabola(speed: float, acceleration: float, points: int) -> None:
    """At the mean stamp a line's slope is a parabola's derivative."""
    t_ns = EPOCH + np.arange(60, dtype=np.int64) * 1_000_000
    t = (t_ns - EPOCH) * 1e-9
    one = ring(t_ns, speed * t + 0.5 * acceleration * t**2)
    there, at, found = slope(*one, 0, (points - 1) * 1_000_000)
    assert there
    assert found == pytest.approx(speed + acceleration * (at - EPOCH) * 1e-9, abs=1e-6)


def test_no_slope_of_one_sample() -> None:
    assert not slope(*ring([1000], [1.0]), 0, 10**9)[0]


@pytest.mark.parametrize("grew", [1.0, 3.0])
def test_what_two_transmitters_differ_by_is_forgotten_and_noise_that_grew_is_not(
    grew: float,
) -> None:
    rng = np.random.default_rng(7)
    noise = rng.standard_normal(1900) * np.where(np.arange(1900) < 1000, 0.3, 0.3 * grew)
    apart = np.where((np.arange(1900) >= 1000) & (np.arange(1900) < 1800), 4.6, 0.0)
    values = noise + apart * (np.arange(1900) % 2)
    stamps, data, count = ring([], [])
    known = np.array([[0.09, 1000.0]])
    for k, v in enumerate(values):
        push_sample(stamps, data, count, 0, EPOCH + k * 1_000_000, float(v))
        learn_noise(stamps, data, int(count[0]), 0, known, 0.09, 2e9)
    assert known[0, 0] > 15 * 0.09
    forget_noise(stamps, data, int(count[0]), 0, known)
    assert known[0, 0] == pytest.approx(0.09 * grew**2, rel=0.6)
    assert known[0, 1] <= 100
    before = known.copy()
    known[0, 0] *= 0.1
    forget_noise(stamps, data, int(count[0]), 0, known)
    assert known[0, 0] == 0.1 * before[0, 0]


def test_a_value_that_stood_still_does_not_hide_noise_for_ever() -> None:
    """Stuck before anything was seen: what was learnt of it was no noise at all, for ever."""
    rng = np.random.default_rng(3)
    values = np.concatenate([np.full(150, 645.6), 0.25 * rng.standard_normal(4000)])
    stamps, data, count = ring([], [])
    known = np.array([[0.09, 50.0]])
    for k, v in enumerate(values):
        push_sample(stamps, data, count, 0, EPOCH + k * 1_000_000, float(v))
        learn_noise(stamps, data, int(count[0]), 0, known, 0.09, 1e9)
        if k == 149:
            before = known.copy()
            forget_noise(stamps, data, int(count[0]), 0, known)
            assert known.tolist() == before.tolist()
            known[0, 0] = 0.0
    assert known[0, 0] == pytest.approx(0.25**2, rel=0.1)
