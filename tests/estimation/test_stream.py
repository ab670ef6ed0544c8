"""Live, replay and batch agree bit for bit; validity goes and comes back with its reason."""

import dataclasses
from typing import Any

import numba
import numpy as np
import pytest

from eps_hil.estimation import batch
from eps_hil.estimation.batch import estimate, events, lanes, sample_periods_s
from eps_hil.estimation.rack_force import RackForceEstimator
from eps_hil.estimation.settings import EstimatorSettings, PlausibilitySettings
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.state import begin_anew, new_moment
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
    return fed(stream, *events(series))


def fed(stream: StreamEstimator, kinds: Any, stamps: Any, values: Any) -> Trace:
    rows: list[Estimate] = []
    for kind, t_ns, value in zip(kinds, stamps, values, strict=True):
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


@pytest.mark.parametrize("stretch", [1, 300, 999, 2999])
def test_a_recording_cut_into_stretches_gives_the_same(
    reference_model: Model, stretch: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So a long one is merged bit by bit; late, early and missing samples at the cuts."""
    series = moving()
    sensor, angle = series["torque_sensor_nm"], series["motor_angle_rad"]
    series["torque_sensor_nm"] = Series(sensor.t_ns[350:-40:3] + 137, sensor.value[350:-40:3])
    series["motor_angle_rad"] = Series(angle.t_ns - 5 * MS, angle.value)
    whole = estimate(series, reference_model)
    monkeypatch.setattr(batch, "STRETCH", stretch)
    assert same(estimate(series, reference_model), whole)


@pytest.mark.parametrize("seed", range(6))
def test_samples_of_any_stamps_are_taken_in_the_order_in_which_they_come_live(
    reference_model: Model, seed: int
) -> None:
    """Lost, doubled and early ones, other rates, and a clock that is set back in some of them."""
    rng = np.random.default_rng(seed)
    series = moving()
    for name, one in series.items():
        kept = np.sort(rng.choice(len(one.t_ns), rng.integers(1500, 2900), replace=seed % 2 == 1))
        t_ns = one.t_ns[kept] + rng.integers(-400, 400, len(kept)) * (rng.random() < 0.5) * 1000
        t_ns[rng.integers(1000, 1500) :] -= int(rng.choice([0, 3, 2000])) * MS
        series[name] = Series(t_ns, one.value[kept])
    one_by_one = live(
        StreamEstimator(reference_model, EstimatorSettings(), sample_periods_s(series)), series
    )
    whole = stream_run(reference_model, series)
    assert same(one_by_one, whole)
    assert len(whole.t_ns) > 1000


def stream_run(model: Model, series: dict[str, Series]) -> Trace:
    stream = StreamEstimator(model, EstimatorSettings(), sample_periods_s(series))
    return stream.run(lanes(series))


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
    late = fed(streams[0], kind, t_ns, value)
    early = fed(streams[1], kind[sync_first], t_ns[sync_first], value[sync_first])
    started = 20  # the very first grid points precede the first samples
    assert np.array_equal(late.rack_force_n[started:], early.rack_force_n[started:])


def test_step_of_the_class_is_the_step_of_the_stream(reference_model: Model) -> None:
    model = dataclasses.replace(reference_model, delays_s=Delays())
    series = {name: one for name, one in moving().items() if name in NAMES[:3]}
    settings = EstimatorSettings(plausibility=PlausibilitySettings(enabled=False))
    stream = StreamEstimator(model, settings, sample_periods_s(series))
    estimator = RackForceEstimator(model, settings)
    compared = 0
    for k in range(2000):
        for name, one in series.items():
            stream.push(name, int(one.t_ns[k]), float(one.value[k]))
        for theirs in stream.estimates(stream.advance(int(series[NAMES[0]].t_ns[k]))):
            if Reason.MOTOR_TORQUE & theirs.reason:
                continue
            noise = stream.memory.noise[:, 0]  # the stream knows it from the samples themselves
            drive = noise[0] + model.sensor_to_rotor**2 * noise[1]
            columns = [float(series[name].value[compared]) for name in NAMES[:3]]
            known = Inputs(
                columns[0],
                columns[1],
                columns[2],
                0.0,
                0.0,
                drive,
                float(noise[2]),
                float(noise[3]),
            )
            assert estimator.step(known).rack_force_n == theirs.rack_force_n
            compared += 1
    assert compared > 1990


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
    assert reasons_around(trace, 2.2, 2.9) == Reason.FINE
    assert np.all(np.isfinite(trace.rack_force_n))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_bad_sample_is_named_and_comes_back(reference_model: Model, bad: float) -> None:
    series = {k: v for k, v in moving().items() if k in NAMES[:3]}
    series["motor_torque_nm"].value[1500] = bad
    trace = stream_run(reference_model, series)
    assert reasons_around(trace, 1.45, 1.52) & Reason.BAD_SAMPLE
    assert reasons_around(trace, 2.3, 2.9) == Reason.FINE
    assert np.all(np.isfinite(trace.rack_force_n))


def test_a_torque_sensor_that_never_was_is_absent_not_lost(reference_model: Model) -> None:
    series = {k: v for k, v in moving().items() if k in (NAMES[0], NAMES[2])}
    assert np.mean(stream_run(reference_model, series).valid) > 0.9


def test_a_torque_sensor_that_is_mapped_and_never_comes_is_missing(reference_model: Model) -> None:
    """A live stream knows that it should come: nobody can tell what the driver does meanwhile."""
    series = {k: v for k, v in moving(1.0).items() if k in (NAMES[0], NAMES[2])}
    periods = dict.fromkeys(NAMES[:3], 1e-3)
    trace = StreamEstimator(reference_model, EstimatorSettings(), periods).run(lanes(series))
    assert not np.any(trace.valid)
    assert np.all(trace.reason & int(Reason.TORQUE_SENSOR))


@pytest.mark.parametrize("hole_ms", [900, 1200])
def test_a_torque_sensor_that_does_not_return_from_an_outage_is_missing(
    reference_model: Model, hole_ms: int
) -> None:
    """An outage of over a second begins anew; the torsion bar was taken as absent from then on."""
    series, end = {}, 1000 + hole_ms
    for name, one in moving(3.5).items():
        keep = one.t_ns < 1000 * MS
        if name != "torque_sensor_nm":
            keep |= one.t_ns >= end * MS
        series[name] = Series(one.t_ns[keep], one.value[keep])
    trace = stream_run(reference_model, series)
    after = trace.t_ns > (end + 50) * MS
    assert np.sum(after) > 1000
    assert np.all(trace.reason[after] & int(Reason.TORQUE_SENSOR))


@pytest.mark.parametrize("jump_s", [-100, 3600])
def test_a_jump_of_time_starts_anew(reference_model: Model, jump_s: int) -> None:
    before, after = moving(1.0, 200_000 * MS), moving(1.0, (200_000 + jump_s * 1000) * MS)
    stream = StreamEstimator(
        reference_model, EstimatorSettings(), sample_periods_s({n: before[n] for n in NAMES[:3]})
    )
    live(stream, {n: before[n] for n in NAMES[:3]})
    again = live(stream, {n: after[n] for n in NAMES[:3]})
    assert Reason(int(again.reason[0])) & Reason.TIME
    assert np.all(again.valid[800:])


def test_a_rotor_that_turns_round_as_a_gap_begins_did_not_rest(reference_model: Model) -> None:
    """Its speed passes zero there, and it may have swung through the whole gap."""
    t_ns = np.arange(1000, dtype=np.int64) * MS
    speed = np.maximum(-20.0 + 0.3 * np.arange(1000), -20.0) * (t_ns < 70 * MS)
    columns = {
        "motor_torque_nm": np.full(1000, 0.2),
        "torque_sensor_nm": np.zeros(1000),
        "motor_speed_rad_s": speed,
        "motor_angle_rad": np.cumsum(speed) * 1e-3,
    }
    kept = (t_ns < 68 * MS) | (t_ns > 260 * MS)
    held = {name: Series(t_ns[kept], v[kept]) for name, v in columns.items()}
    settings = EstimatorSettings(plausibility=PlausibilitySettings(enabled=False))
    stream = StreamEstimator(reference_model, settings, sample_periods_s(held))
    trace = live(stream, held)
    assert not np.any(trace.valid[trace.t_ns > 300 * MS])


@pytest.mark.parametrize(("moved_rad", "known"), [(0.0, True), (0.03, False)])
def test_a_clock_set_back_keeps_the_bristle_of_a_resting_rotor(
    reference_model: Model, moved_rad: float, known: bool
) -> None:
    """By seconds: the rotor slides to rest before, and rests there by angle and torque after."""
    rng = np.random.default_rng(3)
    t_ns = np.arange(3000, dtype=np.int64) * MS + 100_000 * MS
    speed = np.where(t_ns < 101_000 * MS, 20.0, 0.0)
    columns = {
        "motor_torque_nm": np.where(speed > 0.0, 0.3, 0.2) + 2e-3 * rng.standard_normal(3000),
        "torque_sensor_nm": 1e-2 * rng.standard_normal(3000),
        "motor_speed_rad_s": speed + 1e-2 * rng.standard_normal(3000),
        "motor_angle_rad": np.cumsum(speed) * 1e-3 + 1e-3 * rng.standard_normal(3000),
    }
    first = {name: Series(t_ns[:2000], v[:2000]) for name, v in columns.items()}
    columns["motor_angle_rad"][2000:] += moved_rad
    set_back = t_ns[2000:] - 5_000 * MS
    then = {name: Series(set_back, v[2000:]) for name, v in columns.items()}
    settings = EstimatorSettings(plausibility=PlausibilitySettings(enabled=False))
    stream = StreamEstimator(reference_model, settings, sample_periods_s(first))
    before = live(stream, first)
    after = live(stream, then)
    assert before.valid[-1]
    assert bool(after.valid[-1]) == known
    if known:
        assert abs(after.rack_force_n[-1] - before.rack_force_n[-1]) < 20.0


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


@pytest.mark.skipif(getattr(numba.config, "DISABLE_JIT", False), reason="about compiled code")
@pytest.mark.parametrize("kind", ["observer", "bristle_filter"])
def test_a_warm_stream_takes_the_short_way_to_the_same_numbers(
    reference_model: Model, kind: str
) -> None:
    settings = EstimatorSettings(kind=kind)  # type: ignore[arg-type]
    series = moving(0.5)
    cold = StreamEstimator(reference_model, settings, sample_periods_s(series))
    warm = StreamEstimator(reference_model, settings, sample_periods_s(series))
    warm.warm_up()
    assert type(warm._advance).__name__ == "builtin_function_or_method"  # not numba's dispatcher
    assert same(live(cold, series), live(warm, series))


def test_batch_leaves_out_what_was_before_the_recording(reference_model: Model) -> None:
    series = {n: one for n, one in moving(start_ns=10**18).items() if n in NAMES[:3]}
    trace = estimate(series, reference_model)
    assert np.all(np.diff(trace.t_ns) == MS)
    assert trace.t_ns[0] >= 10**18


def test_words_for_people() -> None:
    assert words(Reason.FINE) == "fine"
    assert words(Reason.MOTOR_SPEED | Reason.SETTLING) == "motor speed, settling"


@pytest.mark.parametrize("kind", ["observer", "bristle_filter", "smoother"])
def test_after_a_gap_the_force_is_that_of_a_new_start(
    reference_model: Model, kind: Any, weave_truth: Any
) -> None:
    """A reset once cleared dφ/dx with the rest: 0 N and valid, for ever."""
    t_ns = np.round(weave_truth.columns["time_s"] * 1e9).astype(np.int64)
    columns = {name: weave_truth.columns[name] for name in NAMES}
    gap = (t_ns > 4_000 * MS) & (t_ns < 6_500 * MS)
    whole = {name: Series(t_ns, value) for name, value in columns.items()}
    holed = {name: Series(t_ns[~gap], value[~gap]) for name, value in columns.items()}
    settings = EstimatorSettings(kind=kind)
    expected, trace = (estimate(s, reference_model, settings) for s in (whole, holed))
    both, at, ours = np.intersect1d(expected.t_ns, trace.t_ns, return_indices=True)
    late = both > 7_500 * MS
    assert np.all(trace.valid[ours][late])
    error = trace.rack_force_n[ours][late] - expected.rack_force_n[at][late]
    assert np.max(np.abs(error)) < 50.0
    assert np.ptp(trace.rack_force_n[ours][late]) > 500.0


def test_a_new_state_is_the_first_one(reference_model: Model) -> None:
    """Nothing that a run left behind is kept, but the rig's: its time and its levels."""
    series = {n: one for n, one in moving().items() if n in NAMES}
    stream = StreamEstimator(reference_model, EstimatorSettings(), sample_periods_s(series))
    stream.run(lanes(series))
    used = stream.memory.carried
    rig = used.rig.copy()
    assert used.moment[0].omega != 0.0
    begin_anew(used)
    assert used.moment.tobytes() == new_moment().tobytes()
    assert used.rig.tobytes() == rig.tobytes()


def test_nonsense_makes_a_new_state(reference_model: Model) -> None:
    estimator = RackForceEstimator(reference_model)
    for _ in range(300):
        estimator.step(Inputs(0.5, 0.0, 20.0))
    assert estimator.step(Inputs(1e9, 0.0, 20.0)).reason & Reason.DIVERGED
    told = [estimator.step(Inputs(0.5, 0.0, 20.0)) for _ in range(300)]
    fresh = RackForceEstimator(reference_model)
    first = [fresh.step(Inputs(0.5, 0.0, 20.0)) for _ in range(300)]
    assert told == first


@pytest.mark.parametrize("phase_ns", [0, 250_000, 500_000])
def test_interpolated_noise_is_not_taken_for_less_noise(
    reference_model: Model, phase_ns: int
) -> None:
    """Half way between two samples white noise is halved, and its second differences are a sixth.

    What is left of it after averaging is the same.
    """
    rng = np.random.default_rng(3)
    t_ns = np.arange(3000, dtype=np.int64) * MS + phase_ns
    noise = dict(zip(NAMES, (4e-3, 1e-2, 0.25, 2e-3), strict=False))
    stream = StreamEstimator(reference_model, EstimatorSettings(), dict.fromkeys(NAMES[:4], 1e-3))
    for k in range(3000):
        for name, sigma in noise.items():
            stream.push(name, int(t_ns[k]), sigma * rng.standard_normal())
        stream.advance(k * MS)
    assert stream.memory.carried.moment[0].speed_noise == pytest.approx(0.25**2, rel=0.2)


def test_two_transmitters_by_turns_leave_no_noise_behind(reference_model: Model) -> None:
    """Their difference was learnt as noise for seconds: slow creep of the rotor counted as rest."""
    clean, turns = moving(4.0), moving(4.0)
    k = np.arange(1000, 1500)
    turns[NAMES[0]].value[k] -= 0.31 * (k % 2)
    turns[NAMES[2]].value[k] -= 4.6 * (k % 2)
    noise = []
    for series in (clean, turns):
        stream = StreamEstimator(reference_model, EstimatorSettings(), sample_periods_s(series))
        sync = series[NAMES[2]].t_ns
        stream.run(lanes(series), until=int(np.searchsorted(sync, sync[0] + 3_200 * MS)))
        noise.append(stream.memory.noise[: len(NAMES), 0].copy())
    assert np.all(noise[1] < 2.0 * noise[0])
