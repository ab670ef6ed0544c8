"""Means in bins, and what they are worth elsewhere."""

import numpy as np
import pytest

from eps_hil.diagnosis.mismatch.binned import gain_elsewhere, means, places, points

EDGES = np.array([0.0, 1.0, 2.0, 4.0])


def test_places_take_the_ends_and_what_lies_beyond() -> None:
    values = np.array([-1.0, 0.0, 0.5, 1.0, 3.9, 4.0, 9.0])
    np.testing.assert_array_equal(places(EDGES, values), [0, 0, 0, 1, 2, 2, 2])


def test_means_of_bins_with_enough_in_them() -> None:
    place, values = np.array([0, 0, 0, 2]), np.array([1.0, 2.0, 6.0, 5.0])
    np.testing.assert_array_equal(means(place, values, 3), [3.0, 0.0, 5.0])
    np.testing.assert_array_equal(means(place, values, 3, fewest=2), [3.0, 0.0, 0.0])


def test_a_curve_that_comes_again_takes_away_all_that_it_is() -> None:
    place, block = np.tile(np.arange(3), 40), np.repeat(np.arange(4), 30)
    values = np.array([2.0, -1.0, 0.5])[place]
    assert gain_elsewhere(place, values, block, 3) == pytest.approx(np.sum(values**2))


def test_a_curve_that_turns_over_from_block_to_block_costs() -> None:
    place, block = np.tile(np.arange(3), 40), np.repeat(np.arange(4), 30)
    values = np.array([2.0, -1.0, 0.5])[place] * np.where(block % 2, 1.0, -1.0)
    assert gain_elsewhere(place, values, block, 3) == pytest.approx(-3.0 * np.sum(values**2))


def test_noise_gains_nothing() -> None:
    """A mean of m samples costs 1 / m of a variance wherever it is used: 20 in all here."""
    rng = np.random.default_rng(3)
    place, block = rng.integers(0, 10, 20_000), np.arange(20_000) // 500
    values = rng.standard_normal(20_000)
    assert -60.0 < gain_elsewhere(place, values, block, 10) < 10.0


def test_points_stand_in_the_middle_of_their_bins() -> None:
    curve = points(EDGES, np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3]))
    assert curve == ((0.5, 1.0, 0.1), (1.5, 2.0, 0.2), (3.0, 3.0, 0.3))
