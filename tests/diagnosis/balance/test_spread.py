"""Intervals: closed forms, and how often they hold the truth."""

import numpy as np
import pytest
from scipy.stats import t

from eps_hil.diagnosis.balance.spread import FEWEST, half_widths, left_open, parts


def groups(n: int, size: int) -> np.ndarray:
    return np.arange(n) // size


def test_samples_alone_are_the_textbook() -> None:
    """White noise, one number: sigma over the root of the sum of squares."""
    rng = np.random.default_rng(1)
    n, sigma = 20_000, 0.7
    column = rng.uniform(0.5, 1.5, (n, 1))
    _, deviation, freedom = parts(column, sigma * rng.standard_normal(n), ())
    assert deviation[0, 0] == pytest.approx(sigma / np.linalg.norm(column), rel=0.03)
    sharing = (13 / 12) ** 2 / ((1.5**5 - 0.5**5) / 5)  # mean square of the squares, at most one
    assert freedom[0, 0] == pytest.approx(sharing * n, rel=0.03)


def test_a_residual_that_lasts_counts_once() -> None:
    """Noise with one value for each 50 samples: a deviation larger by the root of 50."""
    rng = np.random.default_rng(2)
    n, size = 20_000, 50
    residual = np.repeat(rng.standard_normal(n // size), size)
    column = np.ones((n, 1))
    _, deviation, _ = parts(column, residual, (groups(n, size),))
    assert deviation[1, 0] == pytest.approx(np.sqrt(size / n), rel=0.1)
    assert deviation[0, 0] == pytest.approx(1 / np.sqrt(n), rel=0.1)


def test_a_number_known_from_two_stretches_has_few_degrees_of_freedom() -> None:
    n, size = 1000, 100
    column = np.zeros((n, 2))
    column[:200, 0] = 1.0
    column[:, 1] = 1.0
    rng = np.random.default_rng(3)
    widths, deviation, freedom = parts(column, rng.standard_normal(n), (groups(n, size),))
    assert freedom[1, 0] == pytest.approx(FEWEST, abs=0.6)
    assert freedom[1, 1] > 4
    assert widths[1, 0] == pytest.approx(t.ppf(0.975, freedom[1, 0]) * deviation[1, 0])


def test_a_prior_bounds_what_nothing_tells() -> None:
    column = np.full((100, 1), 1e-6)
    wide = half_widths(column, np.ones(100), (groups(100, 10),), prior=1)
    assert wide[0] < 5.0


@pytest.mark.parametrize("held", [1, 25])
def test_intervals_hold_the_truth(held: int) -> None:
    """A level and a slope under noise that lasts ``held`` samples: 95 %, and not all of them."""
    rng = np.random.default_rng(4)
    n, inside = 1000, 0
    column = np.column_stack([np.ones(n), np.linspace(-1, 1, n)])
    for _ in range(400):
        noise = np.repeat(rng.standard_normal(n // held), held)
        found = np.linalg.lstsq(column, noise, rcond=None)[0]
        wide = half_widths(column, noise - column @ found, (groups(n, 50),))
        inside += int(np.sum(np.abs(found) < wide))
    assert 0.90 < inside / 800 < 0.995


def finding(effect: str, **numbers: tuple[float, float, float]) -> dict[str, object]:
    told = {
        k: {"value": v, "unit": "", "ci95": [low, high]} for k, (v, low, high) in numbers.items()
    }
    return {"effect": effect, "parameters": told}


def test_a_number_that_may_be_what_it_cannot_be_is_said_to_be_open() -> None:
    dwell = finding(
        "breakaway_dwell",
        level_nm=(0.45, 0.1, 0.8),
        time_s=(1.5, -0.3, 3.3),
        release_rad=(2.0, 1.0, 3.0),
    )
    (said,) = left_open([dwell])
    assert said.startswith("breakaway_dwell: these recordings leave open ")
    assert "level_nm (0.1 Nm or more) and time_s (anything up to 3.3 s)" in said
    assert "release_rad" not in said


def test_what_is_known_turns_round_or_has_no_interval_is_not_open() -> None:
    unknown = {"effect": "unknown", "parameters": {}}
    ripple = finding(
        "cogging_torque",
        amplitude_nm=(0.01, 0.008, 0.012),
        order=(8.0, 7.9, 8.1),
        phase_rad=(3.1, 2.8, 3.4),
    )
    curve = {
        "effect": "position_torque",
        "parameters": {"curve": {"value": [[0.0, 0.1]], "unit": "Nm", "ci95": None}},
    }
    assert left_open([unknown, ripple, curve]) == []


def test_a_number_that_ended_on_its_bound_is_said_to_be_open() -> None:
    """Its interval, of a fit that could go no further, may well be narrow, or one-sided."""
    gain = finding("motor_torque_gain", gain=(3.0, 2.99, 3.01))
    (said,) = left_open([gain])
    assert "leave open gain (it ended at 3, the bound of what it can be)" in said
    exact = finding("rack_ratio", scale=(-0.5, -0.5, -0.5), slope_per_m=(0.0, -0.1, 0.1))
    (said,) = left_open([exact])
    assert "leave open scale (it ended at -0.5, the bound of what it can be)." in said
    assert left_open([finding("motor_torque_gain", gain=(0.7, 0.69, 0.71))]) == []
