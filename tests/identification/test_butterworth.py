"""The low-pass without phase against scipy's, which is too slow to import."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, sosfiltfilt, sosfreqz

from eps_hil.identification.butterworth import low_pass, passed

ORDERS = st.sampled_from([1, 2, 4])
CORNERS_HZ = st.floats(0.3, 400.0)


@given(CORNERS_HZ, ORDERS, st.integers(16, 3000), st.integers(0, 99))
def test_it_is_scipys(corner_hz: float, order: int, samples: int, seed: int) -> None:
    values = 5.0 + np.random.default_rng(seed).normal(size=samples)
    sos = butter(order, corner_hz, fs=1000.0, output="sos")
    np.testing.assert_allclose(
        low_pass(values, corner_hz, order), sosfiltfilt(sos, values), rtol=1e-7, atol=1e-7
    )


@pytest.mark.parametrize(("corner_hz", "order"), [(20.0, 2), (40.0, 4), (100.0, 4)])
def test_at_the_corners_in_use_to_rounding(corner_hz: float, order: int) -> None:
    values = np.random.default_rng(1).normal(size=5000)
    sos = butter(order, corner_hz, fs=1000.0, output="sos")
    expected = sosfiltfilt(sos, values)
    np.testing.assert_allclose(low_pass(values, corner_hz, order), expected, rtol=0, atol=1e-12)


@given(CORNERS_HZ, ORDERS, st.sampled_from([0, 2, 4]))
def test_noise_that_passes_is_that_of_its_response(
    corner_hz: float, order: int, power: int
) -> None:
    sos = butter(order, corner_hz, fs=1000.0, output="sos")
    frequency_hz, response = sosfreqz(sos, 4096, fs=1000.0)
    density = np.abs(response) ** 4 * (2 * np.pi * frequency_hz) ** power
    assert passed(corner_hz, power, order) == pytest.approx(float(np.mean(density)), rel=1e-8)


def test_noise_that_passes_is_what_comes_out() -> None:
    noise = np.random.default_rng(2).normal(size=200_000)
    out = low_pass(noise, 40.0)
    assert np.var(out) == pytest.approx(passed(40.0, 0), rel=0.03)
    changing = np.gradient(out, 1e-3)
    assert np.var(changing) == pytest.approx(passed(40.0, 2), rel=0.03)


@given(st.floats(-1e6, 1e6), CORNERS_HZ, ORDERS)
def test_a_constant_stays_what_it_is(value: float, corner_hz: float, order: int) -> None:
    out = low_pass(np.full(200, value), corner_hz, order)
    np.testing.assert_allclose(out, value, rtol=1e-6, atol=1e-6)


def test_it_has_no_phase() -> None:
    t = np.arange(4000) * 1e-3
    slow = np.sin(2 * np.pi * 3 * t)
    assert np.max(np.abs(low_pass(slow, 40.0) - slow)[500:-500]) < 1e-3


@pytest.mark.parametrize(("order", "needed"), [(1, 7), (2, 10), (4, 16)])
def test_too_short_for_the_filter_is_said(order: int, needed: int) -> None:
    assert len(low_pass(np.ones(needed), 40.0, order)) == needed
    with pytest.raises(ValueError, match="too short"):
        low_pass(np.ones(needed - 1), 40.0, order)


def test_scipy_signal_is_not_imported_for_it() -> None:
    """What the filter is written out for."""
    script = (
        "import sys, numpy as np; from eps_hil.diagnosis.data import channels;"
        "from eps_hil.diagnosis.direct import rotor_and_rack;"
        "from eps_hil.identification.butterworth import low_pass; low_pass(np.ones(99), 40.0);"
        "print('scipy.signal' in sys.modules)"
    )
    command = [sys.executable, "-c", script]
    said = subprocess.run(command, check=False, capture_output=True, text=True)
    assert said.stdout == "False\n", said.stderr
