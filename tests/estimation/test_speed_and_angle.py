"""Gain and lag between speed and angle: learnt, excused, and doubted where they change."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from eps_hil.estimation.batch import estimate
from eps_hil.estimation.plausibility import judge_step, limits_of
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.state import Records
from eps_hil.estimation.stream import Trace
from eps_hil.estimation.validity import Reason
from eps_hil.estimation.watch import new_watch, watch_anew
from eps_hil.physics.model import Model
from eps_hil.series import Series

from .false_signals import NAMES, OFF, series_of, wrong_ms

NOISE_RAD, NOISE_RAD_S = 1e-3, 0.2


def stops(truth: Any) -> list[int]:
    """Samples at which the rotor comes to rest for a while out of a motion."""
    speed = np.convolve(truth.columns[NAMES[2]], np.ones(5) / 5, "same")
    slow, found = np.abs(speed) < 0.4, []
    for i in range(4000, len(speed) - 800):
        moved = np.abs(speed[i - 150 : i - 20]).max() > 3.0
        if moved and slow[i : i + 60].all() and not slow[i - 1]:
            found.append(i)
    return found


def wrong_and_valid_ms(trace: Trace, right: Trace) -> int:
    """For how many milliseconds both were valid and more than 100 N apart."""
    wrong = np.abs(trace.rack_force_n - right.rack_force_n) > 100.0
    return int(np.count_nonzero(wrong & trace.valid & right.valid))


@pytest.mark.parametrize("offset", [1.2, -1.2])
def test_a_small_offset_of_the_speed_in_motion_is_told(
    reference_model: Model, steps_truth: Any, offset: float
) -> None:
    """It leaves the bristle elsewhere as the rotor stops; a third of the way was once excused."""
    right, believed = estimate(series_of(steps_truth), reference_model), 0
    at = stops(steps_truth)
    assert len(at) >= 4
    for stop in at:
        series = series_of(steps_truth)
        since, until = stop - 290, stop + 10
        series[NAMES[2]].value[since:until] += offset
        trace = estimate(series, reference_model)
        part = (trace.t_ns > since * 10**6) & (trace.t_ns < (until + 30) * 10**6)
        assert np.any(trace.reason[part] & int(Reason.INCONSISTENT))
        assert wrong_and_valid_ms(trace, right) <= 20
        believed += wrong_ms(estimate(series, reference_model, OFF), right)
    assert believed > 100, "nothing to tell"


def watched(
    watch: Records,
    model: Model,
    gain: float,
    late_steps: int,
    seconds: float = 8.0,
    offset: npt.NDArray[np.float64] | None = None,
    rest_s: float = 0.0,
    jump_rad: float = 0.0,
) -> npt.NDArray[np.bool_]:
    """(n,) where a rotor is told that swings by ±20 rad/s; its speed reads ``gain`` times too much,
    ``late_steps`` ms late. It rests for ``rest_s``, and its angle jumps meanwhile for 0.13 s."""
    rng, limits = np.random.default_rng(1), limits_of(model, EstimatorSettings(), True)
    n = round(seconds * 1e3)
    t = np.arange(n + late_steps) * 1e-3
    true = 20.0 * np.sin(2 * np.pi * 0.8 * t) + 4.0 * np.sin(2 * np.pi * 5.0 * t)
    true[t < rest_s] = 0.0
    way = np.cumsum(0.5e-3 * (true + np.concatenate([[0.0], true[:-1]])))
    angle = way[late_steps:] + NOISE_RAD * rng.standard_normal(n)
    angle[(t[:n] > 0.3) & (t[:n] < 0.43)] += jump_rad
    speed = gain * true[:n] + NOISE_RAD_S * rng.standard_normal(n)
    speed += 0.0 if offset is None else offset
    found = np.zeros(n, bool)
    for k in range(n):
        u = Inputs(0.0, 0.0, speed[k], angle[k], 0.0, 1e-6, NOISE_RAD_S**2, NOISE_RAD**2, 1.0, 1.0)
        found[k] = judge_step(watch, limits, u, True, 0, True)[0] & int(Reason.INCONSISTENT) != 0
    return found


@pytest.mark.parametrize(("gain", "late_steps"), [(1.0, 0), (0.9, 3), (1.08, 2)])
def test_gain_and_lag_of_the_rig_are_no_fault(
    reference_model: Model, gain: float, late_steps: int
) -> None:
    """Residual: 1 − gain of the angle's way, and the lag times the speed's change."""
    watch = new_watch()
    assert not np.any(watched(watch, reference_model, gain, late_steps))
    w = watch[0]
    assert w.gain_off == pytest.approx(1.0 - gain, abs=0.003)
    assert w.lag_s == pytest.approx(late_steps * 1e-3, abs=0.0002)
    known = float(w.gain_off), float(w.lag_s), float(w.gain_variance)
    watch_anew(watch)
    assert (float(w.gain_off), float(w.lag_s), float(w.gain_variance)) == known


def test_an_angle_that_jumps_teaches_nothing(reference_model: Model) -> None:
    """What is left of it in sums over 100 ms was taken for a gain: 0.4 s of motion were doubted."""
    watch = new_watch()
    found = watched(watch, reference_model, 1.0, 0, rest_s=1.2, jump_rad=1.71)
    assert np.any(found[300:450])
    assert not np.any(found[700:])
    assert watch[0].gain_off == pytest.approx(0.0, abs=0.003)


def test_what_they_do_not_explain_is_told_and_not_learnt(reference_model: Model) -> None:
    """An offset of 1 rad/s of a speed that reads 10 % too little: told while it lasts."""
    watch = new_watch()
    offset = np.where((np.arange(8000) >= 6000) & (np.arange(8000) < 7000), 1.0, 0.0)
    found = watched(watch, reference_model, 0.9, 3, offset=offset)
    assert not np.any(found[:6000])
    assert np.mean(found[6200:7000]) > 0.5
    assert not np.any(found[7600:])
    assert watch[0].gain_off == pytest.approx(0.1, abs=0.005)


def test_a_relation_that_changes_for_good_is_believed_in_the_end(reference_model: Model) -> None:
    watch = new_watch()
    assert not np.any(watched(watch, reference_model, 1.0, 0))
    watch[0].angle = 0.0
    found = watched(watch, reference_model, 0.92, 0, seconds=16.0)
    assert np.any(found[500:5000])
    assert not np.any(found[12_000:])
    assert watch[0].gain_off == pytest.approx(0.08, abs=0.005)


def test_a_service_that_starts_with_a_frozen_speed_does_not_keep_that(
    reference_model: Model,
) -> None:
    """It was taken for gain and lag of the rig, and what was right afterwards was doubted."""
    rng, limits = np.random.default_rng(2), limits_of(reference_model, EstimatorSettings(), True)
    watch, t = new_watch(), np.arange(5000) * 1e-3
    true = np.where(t < 0.4, -43.0 - 12.5 * t, -48.0 * np.cos(2 * np.pi * 0.2 * (t - 0.4)))
    angle = np.cumsum(0.5e-3 * (true + np.concatenate([[-43.0], true[:-1]])))
    angle += NOISE_RAD * rng.standard_normal(5000)
    speed = np.where(t < 0.4, -43.0, true + NOISE_RAD_S * rng.standard_normal(5000))
    found = np.zeros(5000, bool)
    for k in range(5000):
        u = Inputs(0.0, 0.0, speed[k], angle[k], 0.0, 1e-6, NOISE_RAD_S**2, NOISE_RAD**2, 1.0, 1.0)
        found[k] = judge_step(watch, limits, u, True, 0, True)[0] & int(Reason.INCONSISTENT) != 0
    assert np.any(found[400:420])
    assert not np.any(found[2000:])


@pytest.mark.parametrize("off", [1.0, 1.77])
def test_a_relation_learnt_half_within_an_offset_is_not_believed(
    reference_model: Model, off: float
) -> None:
    """What gain and lag leave of its first looks tells that these do not belong together."""
    offset = np.where(np.arange(4000) < 350, off, 0.0)
    found = watched(new_watch(), reference_model, 1.0, 0, seconds=4.0, offset=offset)
    assert not np.any(found[500:])


@pytest.mark.parametrize("after_ms", [1, 2, 4, 7])
def test_a_speed_that_jumps_soon_after_a_hole_is_told(
    reference_model: Model, sweep_truth: Any, after_ms: int
) -> None:
    """Neither side of the hole shows it, nor is there a course of the speed before the jump."""
    missed, believed = _missed(reference_model, sweep_truth, range(31_000, 33_000, 100), after_ms)
    assert missed == 0
    assert believed > 10, "nothing to tell"


@pytest.mark.parametrize("before_ms", [3, 6])
def test_a_speed_that_jumps_just_before_a_hole_is_told(
    reference_model: Model, sweep_truth: Any, before_ms: int
) -> None:
    """Drawn straight from end to end, angle and speed went apart within the hole by themselves."""
    some = range(31_000, 33_000, 100)
    missed, believed = _missed(reference_model, sweep_truth, some, -15 - before_ms)
    assert missed == 0
    assert believed > 10, "nothing to tell"


def test_a_speed_that_jumps_in_a_long_hole_is_not_believed_until_the_angle_tells(
    reference_model: Model, sweep_truth: Any
) -> None:
    """It is drawn over the hole, and wrong there before anything can be seen."""
    missed, believed = _missed(reference_model, sweep_truth, range(31_000, 33_000, 50), 0)
    assert missed <= 2
    assert believed > 10, "nothing to tell"


def _missed(model: Model, truth: Any, some: range, after_ms: int) -> tuple[int, int]:
    """How often a speed that is 7.4 rad/s off is wrong and valid for over 20 ms, and how often it
    would be if nothing looked at it; it is off from ``after_ms`` after the end of a hole of 15 ms.
    """
    believed = missed = 0
    for at in some:
        part = slice(at - 1500, at + 300)
        right = {n: Series(s.t_ns[part], s.value[part]) for n, s in series_of(truth).items()}
        speed = right[NAMES[2]].value.copy()
        speed[1500:] += 7.4 if at // some.step % 2 else -7.4
        kept = np.ones(1800, bool)
        kept[1485 - after_ms : 1500 - after_ms] = False
        lied = {**right, NAMES[2]: Series(right[NAMES[2]].t_ns, speed)}
        lied = {name: Series(s.t_ns[kept], s.value[kept]) for name, s in lied.items()}
        whole = estimate(right, model)
        missed += wrong_and_valid_ms(estimate(lied, model), whole) > 20
        believed += wrong_and_valid_ms(estimate(lied, model, OFF), whole) > 20
    return missed, believed
