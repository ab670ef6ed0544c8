"""Live, replay and batch agree bit for bit; validity goes and comes back with its reason."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.batch import estimate, events, sample_periods_s
from eps_hil.estimation.rack_force import RackForceEstimator
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.stream import SIGNALS, Estimate, StreamEstimator, Trace
from eps_hil.estimation.validity import Reason, words
from eps_hil.physics.model import Delays, Model
from eps_hil.series import Series

MS = 1_000_000
NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")


def moving(seconds: float = 3.0, start_ns: int = 0, seed: int = 0) -> dict[str, Series]:
    """A plausible recording: slow sine of everything, with noise."""
    rng = np.random.default_rng(seed)
    n = round(seconds * 1000)
    t = np.arange(n) * 1e-3
    waves = {
        "motor_torque_nm": 0.4 * np.sin(9 * t),
        "torque_sensor_nm": 0.6 * np.sin(5 * t + 1),
        "motor_speed_rad_s": 60 * np.sin(7 * t + 2),
        "motor_angle_rad": -60 / 7 * np.cos(7 * t + 2),
    }
    t_ns = start_ns + np.arange(n, dtype=np.int64) * MS
    return {k: Series(t_ns, v + 1e-2 * rng.standard_normal(n)) for k, v in waves.items()}


def live(stream: StreamEstimator, series: dict[str, Series]) -> Trace:
    """Feed events one by one, as the service does."""
    rows: list[Estimate] = []
    for kind, t_ns, value in zip(*events(series), strict=True):
        if kind >= 0:
            stream.push(SIGNALS[kind], int(t_ns), float(value))
        else:
            rows += stream.estimates(stream.advance(int(t_ns)))
    t, force, friction, _, reason = zip(*rows, strict=True)
    return Trace(np.array(t), np.array(force), np.array(friction), np.array(reason, np.int64))


def same(a: Trace, b: Trace) -> bool:
    return all(
        np.array_equal(getattr(a, field.name), getattr(b, field.name))
        for field in dataclasses.fields(Trace)
    )


@pytest.mark.parametrize("names", [NAMES[:3], NAMES, (NAMES[0], NAMES[3])])
@pytest.mark.parametrize("start_ns", [0, 1_757_617_431_821_276_000])
def test_live_and_batch_agree_bit_for_bit(
    reference_model: Model, names: tuple[str, ...], start_ns: int
) -> None:
    series = {name: one for name, one in moving(start_ns=start_ns).items() if name in names}
    stream = StreamEstimator(reference_model, EstimatorSettings(), sample_periods_s(series))
    one_by_one = live(stream, series)
    batch = stream_run(reference_model, series)
    assert same(one_by_one, batch)
    assert np.sum(batch.valid) > 2500


def stream_run(model: Model, series: dict[str, Series]) -> Trace:
    stream = StreamEstimator(model, EstimatorSettings(), sample_periods_s(series))
    return stream.run(*events(series))


def test_order_of_frames_within_a_millisecond_does_not_matter(reference_model: Model) -> None:
    """The sync frame may come before or after the other frames of its millisecond."""
    series = {name: one for name, one in moving().items() if name in NAMES[:3]}
    kind, t_ns, value = events(series)
    streams = [
        StreamEstimator(reference_model, EstimatorSettings(), sample_periods_s(series))
        for _ in range(2)
    ]
    sync_first = np.lexsort((kind, t_ns))  # -1 sorts before every signal of the same stamp
    assert kind[sync_first][0] == -1
    assert kind[0] != -1
    late = streams[0].run(kind, t_ns, value)
    early = streams[1].run(kind[sync_first], t_ns[sync_first], value[sync_first])
    started = 20  # the very first grid points precede the first samples
    assert np.array_equal(late.rack_force_n[started:], early.rack_force_n[started:])


def test_step_of_the_class_is_the_step_of_the_stream(reference_model: Model) -> None:
    model = dataclasses.replace(reference_model, delays_s=Delays())
    series = {name: one for name, one in moving().items() if name in NAMES[:3]}
    trace = stream_run(model, series)
    estimator = RackForceEstimator(model, EstimatorSettings())
    columns = [series[name].value for name in NAMES[:3]]
    stepped = [estimator.step(Inputs(*(float(c[k]) for c in columns))) for k in range(2000)]
    ours = np.array([out.rack_force_n for out in stepped])
    started = int(np.argmax(trace.reason == int(Reason.SETTLING)))
    assert np.array_equal(trace.rack_force_n[started : started + 2000], ours)


def test_look_back_covers_every_delay(reference_model: Model) -> None:
    stream = StreamEstimator(reference_model, EstimatorSettings(), dict.fromkeys(NAMES[:3], 1e-3))
    assert stream.timing.lookback == 5 * MS  # 4 ms of delay, one sample
    assert stream.latency_s > 0.005


def test_needs_torque_and_motion(reference_model: Model) -> None:
    with pytest.raises(ValueError, match="motor_speed_rad_s"):
        StreamEstimator(reference_model, EstimatorSettings(), {"motor_torque_nm": 1e-3})
    with pytest.raises(ValueError, match="motor_torque_nm"):
        StreamEstimator(reference_model, EstimatorSettings(), {"motor_speed_rad_s": 1e-3})


def reasons_around(trace: Trace, start_s: float, end_s: float) -> Reason:
    inside = (trace.t_ns > start_s * 1e9) & (trace.t_ns < end_s * 1e9)
    return Reason(int(np.bitwise_or.reduce(trace.reason[inside])))


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("motor_torque_nm", Reason.MOTOR_TORQUE),
        ("torque_sensor_nm", Reason.TORQUE_SENSOR),
        ("motor_speed_rad_s", Reason.MOTOR_SPEED),
    ],
)
def test_a_lost_signal_is_named_and_comes_back(
    reference_model: Model, name: str, reason: Reason
) -> None:
    series: dict[str, Any] = {k: v for k, v in moving().items() if k in NAMES[:3]}
    keep = (series[name].t_ns < 1000 * MS) | (series[name].t_ns > 1400 * MS)
    series[name] = Series(series[name].t_ns[keep], series[name].value[keep])
    trace = stream_run(reference_model, series)
    assert reasons_around(trace, 0.5, 0.95) == Reason.FINE
    said = reasons_around(trace, 1.05, 1.35)
    assert said & (reason | Reason.GAP)
    assert not said & ~(reason | Reason.GAP | Reason.SETTLING)
    inside = (trace.t_ns > 1.05e9) & (trace.t_ns < 1.35e9)
    assert not np.any(trace.valid[inside])
    assert len(set(trace.rack_force_n[inside])) <= 2, "the last estimate is held"
    assert reasons_around(trace, 1.6, 2.9) == Reason.FINE
    assert np.all(np.isfinite(trace.rack_force_n))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_bad_sample_is_named_and_comes_back(reference_model: Model, bad: float) -> None:
    series = {k: v for k, v in moving().items() if k in NAMES[:3]}
    series["motor_torque_nm"].value[1500] = bad
    trace = stream_run(reference_model, series)
    assert reasons_around(trace, 1.45, 1.52) & Reason.BAD_SAMPLE
    assert reasons_around(trace, 1.7, 2.9) == Reason.FINE
    assert np.all(np.isfinite(trace.rack_force_n))


def test_a_torque_sensor_that_never_was_is_absent_not_lost(reference_model: Model) -> None:
    series = {k: v for k, v in moving().items() if k in (NAMES[0], NAMES[2])}
    assert np.mean(stream_run(reference_model, series).valid) > 0.9
    # announced by the DBC, but nobody sends it
    periods = dict.fromkeys(NAMES[:3], 1e-3)
    stream = StreamEstimator(reference_model, EstimatorSettings(), periods)
    assert np.mean(stream.run(*events(series)).valid) > 0.9


@pytest.mark.parametrize("jump_s", [-100, 3600])
def test_a_jump_of_time_starts_anew(reference_model: Model, jump_s: int) -> None:
    before, after = moving(1.0, 200_000 * MS), moving(1.0, (200_000 + jump_s * 1000) * MS)
    stream = StreamEstimator(
        reference_model, EstimatorSettings(), sample_periods_s({n: before[n] for n in NAMES[:3]})
    )
    live(stream, {n: before[n] for n in NAMES[:3]})
    again = live(stream, {n: after[n] for n in NAMES[:3]})
    assert Reason(int(again.reason[0])) & Reason.TIME
    assert np.all(again.valid[400:])


def test_nothing_said_before_there_is_anything(reference_model: Model) -> None:
    stream = StreamEstimator(reference_model, EstimatorSettings(), dict.fromkeys(NAMES[:3], 1e-3))
    assert stream.latest.reason & Reason.NOT_STARTED
    assert not stream.latest.valid


def test_warm_up_leaves_no_trace(reference_model: Model) -> None:
    series = {n: one for n, one in moving().items() if n in NAMES[:3]}
    periods = sample_periods_s(series)
    cold = StreamEstimator(reference_model, EstimatorSettings(), periods)
    warm = StreamEstimator(reference_model, EstimatorSettings(), periods)
    warm.warm_up()
    assert same(live(cold, series), live(warm, series))


def test_batch_leaves_out_what_was_before_the_recording(reference_model: Model) -> None:
    series = {n: one for n, one in moving(start_ns=10**18).items() if n in NAMES[:3]}
    trace = estimate(series, reference_model)
    assert np.all(np.diff(trace.t_ns) == MS)
    assert trace.t_ns[0] >= 10**18


def test_words_for_people() -> None:
    assert words(Reason.FINE) == "fine"
    assert words(Reason.MOTOR_SPEED | Reason.SETTLING) == "motor speed, settling"
