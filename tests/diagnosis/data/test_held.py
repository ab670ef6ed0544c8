"""A slow signal that fills a fast table with repeats, and those that only look like one."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from eps_hil.diagnosis.data.held import own_sampled, own_samples
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.data.quality import look_at
from eps_hil.series import Series

Jittered = tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]
N = 20_000
T_NS = np.arange(N, dtype=np.int64) * 1_000_000 + 1_700_000_000_000_000_000


def force(noise: float = 12.0, quantum: float = 2.0) -> npt.NDArray[np.float64]:
    clean = 800.0 * np.sin(2 * np.pi * 0.4e-3 * np.arange(N))
    noisy = clean + noise * np.random.default_rng(1).standard_normal(N)
    return np.asarray(np.round(noisy / quantum) * quantum)


def held(values: npt.NDArray[np.float64], step: int, first: int = 0) -> npt.NDArray[np.float64]:
    """Only every ``step``-th value from ``first`` on, each until the next; before it the first."""
    last = np.maximum((np.arange(N) - first) // step, 0) * step + first
    return np.asarray(values[last])


@pytest.mark.parametrize(("step", "first"), [(3, 0), (10, 0), (10, 7)])
def test_repeats_are_taken_out(step: int, first: int) -> None:
    one = own_sampled(Series(T_NS, held(force(), step, first)))
    np.testing.assert_array_equal(one.t_ns, T_NS[first::step])
    np.testing.assert_array_equal(one.value, force()[first::step])


def test_a_value_that_stays_is_a_sample_like_the_others() -> None:
    values = force(noise=1.0, quantum=20.0)
    assert np.mean(np.diff(values[::10]) == 0) > 0.1
    np.testing.assert_array_equal(own_sampled(Series(T_NS, held(values, 10))).value, values[::10])


def test_lost_rows_and_bad_samples_do_not_hide_it() -> None:
    values, keep = held(force(), 10), np.ones(N, dtype=bool)
    keep[3333:3456] = False
    keep[5001:19000:1000] = False
    values[8004:8237] = np.nan
    one = own_sampled(Series(T_NS[keep], values[keep]))
    assert np.all((one.t_ns - T_NS[0]) % 10_000_000 == 0)
    assert np.count_nonzero(np.isnan(one.value)) == 23


def with_jitter(values: npt.NDArray[np.float64], usual: float, spread: float) -> Jittered:
    """(each value until the next read, rows at which it was read: about every ``usual``-th)."""
    steps = np.random.default_rng(3).normal(usual, spread, N)
    read = np.cumsum(np.maximum(np.round(steps), 1)).astype(int)
    read = np.concatenate([[0], read[read < N]])
    return values[read[np.searchsorted(read, np.arange(N), side="right") - 1]], read


@pytest.mark.parametrize(("usual", "spread"), [(10.0, 1.0), (10.0, 2.0), (5.0, 0.8)])
def test_repeats_of_a_signal_read_with_jitter_are_taken_out(usual: float, spread: float) -> None:
    values, read = with_jitter(force(), usual, spread)
    one = own_sampled(Series(T_NS, values))
    assert (
        np.mean(np.isin(one.t_ns, T_NS[read])) > 0.9
    )  # of those with the value before it is guessed
    assert len(one.t_ns) == pytest.approx(len(read), rel=0.02)
    np.testing.assert_array_equal(one.value, values[np.searchsorted(T_NS, one.t_ns)])
    assert all(found.flags == [] for found in look_at("r", {"rack_force_n": one}).channels)


@pytest.mark.parametrize(
    "values",
    [
        force(),
        np.round(3.3e-3 * np.arange(N) / 0.03) * 0.03,
        np.round(np.sin(2e-3 * np.arange(N)) / 0.03) * 0.03,
        held(force(), 2),
        force(noise=1.0, quantum=20.0),
        np.where(np.arange(N) < 10_000, held(force(), 10), force()),
        np.zeros(N),
        np.where(np.arange(N) < 9000, 1.0, 2.0),
    ],
    ids=[
        "fast",
        "coarse ramp",
        "coarse swing",
        "every other row",
        "coarse",
        "half of it",
        "constant",
        "a switch",
    ],
)
def test_other_signals_stay_as_they_are(values: npt.NDArray[np.float64]) -> None:
    one = Series(T_NS, values)
    assert own_sampled(one) is one


def test_a_held_load_cell_is_a_slow_one(record: Callable[..., Any]) -> None:
    """Nothing of it is clipped, and its noise is that of its own samples."""
    (series,) = record({}, ("weave",), seconds=10.0).values()
    whole = series["rack_force_n"]
    rows = np.arange(len(whole.t_ns)) // 10 * 10
    slow = Series(whole.t_ns[::10], whole.value[::10])
    repeated = {**series, "rack_force_n": Series(whole.t_ns, whole.value[rows])}
    ready = own_samples({"r": repeated})["r"]
    assert ready["motor_torque_nm"] is series["motor_torque_nm"]
    expected = prepare("r", {**series, "rack_force_n": slow})
    found = prepare("r", ready)
    np.testing.assert_array_equal(found.raw["rack_force_n"], expected.raw["rack_force_n"])
    assert found.noise == expected.noise
    assert found.interval_s == pytest.approx(0.01)
    assert all(one.flags == [] for one in look_at("r", ready).channels)
