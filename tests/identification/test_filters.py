"""Signals read at other instants: exact where they are smooth, honest where they are not."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BarycentricInterpolator

from eps_hil.identification.butterworth import low_pass
from eps_hil.identification.filters import between, shifted

Stamps = npt.NDArray[np.int64]
grid_ns: Stamps = np.arange(4000, dtype=np.int64) * 1_000_000


def stamps(every_ms: float, jitter: float = 0.0, seed: int = 0) -> Stamps:
    at = np.arange(round(4000 / every_ms) + 1) * every_ms
    at[1:-1] += np.random.default_rng(seed).uniform(-jitter, jitter, len(at) - 2) * every_ms
    return np.round(at * 1e6).astype(np.int64)


@given(st.floats(2.0, 20.0), st.floats(0.0, 0.3), st.integers(0, 99))
def test_a_cubic_is_read_as_it_is(every_ms: float, jitter: float, seed: int) -> None:
    def cubic(t_ns: Stamps) -> npt.NDArray[np.float64]:
        t = t_ns * 1e-9
        return np.asarray(3.0 - t + 0.5 * t**2 - 0.2 * t**3)

    at = stamps(every_ms, jitter, seed)
    inside = grid_ns[grid_ns <= at[-1]]
    np.testing.assert_allclose(between(at, cubic(at), inside), cubic(inside), atol=1e-9)


@pytest.mark.parametrize(("hz", "lost"), [(10.0, 0.01), (30.0, 0.07)])
def test_straight_lines_take_off_what_a_spline_keeps(hz: float, lost: float) -> None:
    at = stamps(5.0)
    wave = np.sin(2 * np.pi * hz * at * 1e-9)
    truth = np.sin(2 * np.pi * hz * grid_ns * 1e-9)

    def kept(values: npt.NDArray[np.float64]) -> float:
        return float(values @ truth / (truth @ truth))

    assert kept(np.interp(grid_ns, at, wave)) == pytest.approx(1.0 - lost, abs=0.003)
    assert kept(between(at, wave, grid_ns)) == pytest.approx(1.0, abs=0.005)


def test_noise_below_the_cutoff_stays_what_it_is() -> None:
    at = np.arange(20_000, dtype=np.int64) * 5_000_000
    noise = np.random.default_rng(3).normal(size=len(at))
    grid = np.arange(int(at[-1] // 1_000_000), dtype=np.int64) * 1_000_000
    white = low_pass(np.random.default_rng(4).normal(size=len(grid)), 40.0)
    # of 200 values a second it is spread over a fifth of the band
    expected = np.std(white) * np.sqrt(5.0)
    assert np.std(low_pass(between(at, noise, grid), 40.0)) == pytest.approx(expected, rel=0.015)
    assert np.std(low_pass(np.interp(grid, at, noise), 40.0)) < 0.98 * expected


def test_a_hole_is_bridged_straight() -> None:
    at = stamps(10.0)
    at = at[(at < 1_500_000_000) | (at > 1_800_000_000)]
    wave = np.sin(2 * np.pi * 4.0 * at * 1e-9)
    read = between(at, wave, grid_ns)
    hole = (at[at < 1_500_000_000][-1] < grid_ns) & (at[at > 1_800_000_000][0] > grid_ns)
    np.testing.assert_array_equal(read[hole], np.interp(grid_ns, at, wave)[hole])
    away = np.abs(grid_ns - 1_650_000_000) > 250_000_000
    np.testing.assert_allclose(read[away], np.sin(8 * np.pi * grid_ns[away] * 1e-9), atol=1e-3)


def test_two_lost_frames_are_no_hole() -> None:
    at = np.delete(stamps(10.0), [150, 151])
    read = between(at, np.sin(2 * np.pi * 2.0 * at * 1e-9), grid_ns)
    np.testing.assert_allclose(read, np.sin(4 * np.pi * grid_ns * 1e-9), atol=5e-3)


def test_beyond_the_ends_the_last_value_is_held() -> None:
    at = stamps(10.0)[50:200]
    square = np.square(at.astype(np.float64) * 1e-9)
    read = between(at, square, grid_ns)
    assert np.all(read[grid_ns < at[0]] == square[0])
    assert np.all(read[grid_ns > at[-1]] == square[-1])


@pytest.mark.parametrize("at", [stamps(1.0), stamps(10.0)[:3], stamps(0.5)])
def test_fast_or_few_values_are_read_along_straight_lines(at: Stamps) -> None:
    values = np.random.default_rng(1).normal(size=len(at))
    np.testing.assert_array_equal(between(at, values, grid_ns), np.interp(grid_ns, at, values))


def test_stamps_in_bunches_are_read_along_straight_lines() -> None:
    at = stamps(10.0)
    at[1::2] -= 9_500_000  # two at once, every 20 ms
    values = np.random.default_rng(1).normal(size=len(at))
    read = between(at, values, grid_ns)
    np.testing.assert_array_equal(read, np.interp(grid_ns, at, values))
    assert np.max(np.abs(read)) <= np.max(np.abs(values))


@given(st.integers(4, 300), st.floats(-0.4, 0.4), st.integers(0, 99))
def test_shifted_is_a_cubic_through_four_samples_of_held_ends(
    samples: int, seconds: float, seed: int
) -> None:
    values = np.random.default_rng(seed).normal(size=samples)
    pad = 405
    held = np.pad(values, pad, mode="edge")
    at = pad + np.arange(samples) + seconds / 1e-3
    first = np.floor(at).astype(int) - 1
    expected = [
        BarycentricInterpolator(np.arange(4.0), held[k : k + 4])(x - k)
        for k, x in zip(first[:: samples // 4], at[:: samples // 4], strict=True)
    ]
    read = shifted(values, seconds)
    np.testing.assert_allclose(read[:: samples // 4], expected, rtol=0, atol=1e-9)


def test_shifted_by_whole_steps_is_the_signal_itself() -> None:
    values = np.random.default_rng(1).normal(size=50)
    np.testing.assert_array_equal(shifted(values, 0.003)[:-3], values[3:])
    np.testing.assert_array_equal(shifted(values, 0.003)[-3:], values[-1])
    np.testing.assert_array_equal(shifted(values, -0.002)[2:], values[:-2])
    assert shifted(values, 0.0) is values
