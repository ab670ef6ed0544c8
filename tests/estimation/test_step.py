"""A grid finer than a millisecond: the same rig, the same force, and the same times in seconds."""

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from eps_hil.estimation.aligned_rows import AlignedRows
from eps_hil.estimation.batch import estimate, events, lanes, sample_periods_s
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.stream import SIGNALS, Estimate, StreamEstimator, Trace
from eps_hil.estimation.validity import Reason
from eps_hil.physics.model import Model
from eps_hil.series import Series

NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
RATES = (2_000, 4_000)


def sampled(truth: Any, rate_hz: int, seed: int = 0) -> dict[str, Series]:
    """The rig's signals as sampled at a higher rate: late as the reference rig's, white noise."""
    rng = np.random.default_rng(seed)
    n = round((truth.time_s[-1] - 0.01) * rate_hz)
    t_ns = np.arange(n, dtype=np.int64) * (1_000_000_000 // rate_hz)
    sensor = 0.8 * np.sin(2 * np.pi * 0.25 * truth.time_s + 0.4)  # conftest's weave_truth
    parts = zip(
        NAMES,
        (truth.motor_torque_nm, sensor, truth.speed_rad_s, truth.angle_rad),
        (0.001, 0.0, 0.004, 0.004),
        (3e-3, 5e-3, 0.3, 1e-3),
        strict=True,
    )
    return {
        name: Series(
            t_ns,
            CubicSpline(truth.time_s, true)(np.maximum(t_ns * 1e-9 - late_s, 0.0))
            + noise * rng.standard_normal(n),
        )
        for name, true, late_s, noise in parts
    }


def stepping(rate_hz: int, **more: Any) -> EstimatorSettings:
    return EstimatorSettings(step_s=1 / rate_hz, **more)


@pytest.mark.parametrize("kind", ["observer", "bristle_filter"])
@pytest.mark.parametrize("rate_hz", RATES)
def test_a_finer_grid_is_no_worse(
    reference_model: Model, weave_truth: Any, rate_hz: int, kind: Any
) -> None:
    """Against the truth, with the noise of a sample that of the slow rig's."""

    def error_n(trace: Trace) -> float:
        good = trace.valid & (trace.t_ns > 1_000_000_000)
        assert np.mean(trace.valid) > 0.95
        true = np.interp(trace.t_ns[good] * 1e-9, weave_truth.time_s, weave_truth.rack_force_n)
        return float(np.sqrt(np.mean((trace.rack_force_n[good] - true) ** 2)))

    fast = estimate(sampled(weave_truth, rate_hz), reference_model, stepping(rate_hz, kind=kind))
    slow = estimate(sampled(weave_truth, 1_000), reference_model, stepping(1_000, kind=kind))
    assert np.all(np.diff(fast.t_ns) == 1_000_000_000 // rate_hz)
    assert error_n(fast) < (1.0 if kind == "observer" else 1.25) * error_n(slow)


@pytest.mark.parametrize("rate_hz", RATES)
def test_times_stay_seconds(reference_model: Model, weave_truth: Any, rate_hz: int) -> None:
    """Settling and the memory of a doubt do not shrink with the step."""
    series = sampled(weave_truth, rate_hz)
    bad = round(4.0 * rate_hz)
    series["motor_torque_nm"].value[bad] = np.nan

    def invalid_s(trace: Trace) -> float:
        near = (trace.t_ns > 3_900_000_000) & (trace.t_ns < 5_500_000_000)
        assert np.any(trace.reason[near] & int(Reason.BAD_SAMPLE))
        return float(np.sum(~trace.valid[near])) / rate_hz

    settle_s = EstimatorSettings().settle_s
    assert invalid_s(estimate(series, reference_model, stepping(rate_hz))) == pytest.approx(
        settle_s, abs=0.004
    )


@pytest.mark.parametrize("rate_hz", RATES)
def test_a_torque_that_nothing_followed_is_told_at_any_rate(
    reference_model: Model, weave_truth: Any, rate_hz: int
) -> None:
    series = sampled(weave_truth, rate_hz)
    series["motor_torque_nm"].value[3 * rate_hz :] += 3.0
    trace = estimate(series, reference_model, stepping(rate_hz))
    after = (trace.t_ns > 3_010_000_000) & (trace.t_ns < 5_000_000_000)
    assert np.all(trace.reason[after] & int(Reason.INCONSISTENT))
    told_s = trace.t_ns[np.argmax(trace.reason & int(Reason.INCONSISTENT) > 0)] * 1e-9
    assert 2.98 < told_s < 3.01  # an estimate speaks of its lag before


@pytest.mark.parametrize("rate_hz", RATES)
def test_live_and_batch_agree_bit_for_bit(
    reference_model: Model, weave_truth: Any, rate_hz: int
) -> None:
    series = {n: Series(s.t_ns[:8_000], s.value[:8_000]) for n, s in
              sampled(weave_truth, rate_hz).items()}  # fmt: skip
    periods = sample_periods_s(series)
    batch = StreamEstimator(reference_model, stepping(rate_hz), periods).run(lanes(series))
    stream = StreamEstimator(reference_model, stepping(rate_hz), periods)
    live: list[Estimate] = []
    for kind, t_ns, value in zip(*events(series), strict=True):
        if kind >= 0:
            stream.push(SIGNALS[kind], int(t_ns), float(value))
        elif n := stream.advance(int(t_ns)):
            live += stream.estimates(n)
            assert stream.latest == live[-1]
    assert [each.t_ns for each in live] == batch.t_ns.tolist()
    assert [each.rack_force_n for each in live] == batch.rack_force_n.tolist()
    assert [each.friction_torque_nm for each in live] == batch.friction_torque_nm.tolist()
    assert [int(each.reason) for each in live] == batch.reason.tolist()


def test_look_back_ends_one_sample_behind_the_latest_signal(reference_model: Model) -> None:
    stream = StreamEstimator(reference_model, stepping(4_000), dict.fromkeys(NAMES, 0.25e-3))
    assert stream.timing.lookback == 4_250_000  # 4 ms of delay, one sample
    slow = StreamEstimator(reference_model, stepping(1_000), dict.fromkeys(NAMES, 1e-3))
    assert stream.constants.output_lag_s < slow.constants.output_lag_s + 1e-3


def test_what_adaptation_sees_stays_at_a_millisecond(reference_model: Model) -> None:
    rows = AlignedRows(reference_model, stepping(4_000), dict.fromkeys(NAMES, 0.25e-3))
    seen: list[int] = []
    for k in range(200):
        for name in NAMES:
            rows.push(name, k * 250_000, 1.0)
        seen += [at for at, _ in rows.rows(rows.advance(k * 250_000))]
    assert np.all(np.diff(seen) == 1_000_000)


def test_more_samples_than_may_wait_are_all_taken(reference_model: Model) -> None:
    """A sync frame that stays away for long: nothing that came meanwhile is lost."""
    periods = dict.fromkeys(NAMES[:3], 1e-3)
    stream = StreamEstimator(reference_model, EstimatorSettings(), periods)
    for k in range(300):
        for name in NAMES[:3]:
            stream.push(name, k * 1_000_000, 0.1 * k)
        if k % 50 == 49:
            stream.advance(k * 1_000_000)
    assert stream.memory.filled.tolist() == [300, 300, 300, 0, 0]
