"""A speed or an angle that is wrong for a moment or for long: told by the other of the two."""

from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.batch import estimate
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.validity import Reason
from eps_hil.physics.model import Model
from eps_hil.series import Series

from .false_signals import (
    NAMES,
    OFF,
    around,
    series_of,
    told,
    told_at,
    wrong_and_valid_ms,
    wrong_ms,
)


@pytest.mark.parametrize("offset", [-1.1, 0.8, 1.1])
def test_a_speed_that_tells_of_a_way_that_no_angle_shows_is_told(
    reference_model: Model, steps_truth: Any, offset: float
) -> None:
    """The bristle of a resting rotor slides with it, and the estimate by hundreds of N."""
    right = estimate(series_of(steps_truth), reference_model)
    series, since = series_of(steps_truth), 11_700
    series[NAMES[2]].value[since : since + 200] += offset
    trace, believed = (estimate(series, reference_model, s) for s in (EstimatorSettings(), OFF))
    assert told(trace, since, since + 60) & Reason.INCONSISTENT
    assert wrong_and_valid_ms(trace, right) <= 20
    assert wrong_ms(believed, right) > 100, "nothing to tell"
    assert told(trace, since + 700, since + 2000) == told(right, since + 700, since + 2000)


@pytest.mark.parametrize(
    "offset", [-1.2, *(pytest.param(at, marks=pytest.mark.slow) for at in (-1.0, 1.2)), 1.0]
)
def test_a_speed_that_is_off_for_a_moment_is_told_by_the_angle(
    reference_model: Model, steps_truth: Any, offset: float
) -> None:
    """As the rotor comes to rest it leaves the bristle bent; the angle shows no such way."""
    right, spells, believed = estimate(series_of(steps_truth), reference_model), [], []
    for since in range(3100, 18_000, 400):
        series = series_of(steps_truth)
        series[NAMES[2]].value[since : since + 30] += offset
        spells.append(wrong_and_valid_ms(estimate(series, reference_model), right))
        believed.append(wrong_and_valid_ms(estimate(series, reference_model, OFF), right))
    assert max(spells) <= 20
    assert max(believed) > 100, "nothing to tell"


def test_a_speed_that_was_wrong_in_motion_leaves_less_behind(
    reference_model: Model, steps_truth: Any
) -> None:
    """The angle corrects the bristle's path in motion too; before, 595 N were left."""
    right, most = estimate(series_of(steps_truth), reference_model, OFF), 0.0
    for since in range(3000, 18_000, 700):
        series = series_of(steps_truth)
        series[NAMES[2]].value[since : since + 300] += 1.0
        trace = estimate(series, reference_model, OFF)
        after = slice(*np.searchsorted(trace.t_ns, [(since + ms) * 10**6 for ms in (320, 420)]))
        off = trace.rack_force_n[after] - right.rack_force_n[after]
        most = max(most, float(np.abs(off).max()))
    assert most < 350.0


def test_a_speed_that_is_off_until_the_rotor_rests_leaves_no_false_way(
    reference_model: Model, steps_truth: Any
) -> None:
    """In motion it may be a gain, until that is known; its end draws the filtered angle back."""
    whole, spells, off = series_of(steps_truth), [], []
    speed = np.abs(whole[NAMES[2]].value)
    slowed = np.flatnonzero((speed[:-150] > 20.0) & (speed[150:] < 0.3))
    for stop in slowed[np.diff(slowed, prepend=0) > 100] + 150:
        right, false = around(whole, stop, 600, 800), around(whole, stop, 600, 800)
        false[NAMES[2]].value[450:600] += np.copysign(1.8, right[NAMES[2]].value[450])
        truth = estimate(right, reference_model)
        trace = estimate(false, reference_model)
        spells.append(wrong_and_valid_ms(trace, truth))
        off.append(wrong_ms(trace, truth))
    assert len(off) > 4
    assert max(spells) <= 20
    assert max(off) > 100, "nothing to tell"


def test_a_coarse_angle_alone_has_no_speed_beside_it_that_is_off(
    reference_model: Model, steps_truth: Any
) -> None:
    """Its speed is derived from it: what steps of 0.01 rad leave between them is no bias."""
    whole = series_of(steps_truth)
    angle = whole.pop(NAMES[3])
    del whole[NAMES[2]]
    coarse = Series(angle.t_ns[::20], np.round(angle.value[::20] / 0.01) * 0.01)
    unknown = [
        float(np.mean(trace.reason & Reason.FRICTION_UNKNOWN > 0))
        for trace in (
            estimate({**whole, NAMES[3]: one}, reference_model) for one in (angle, coarse)
        )
    ]
    assert unknown[1] == pytest.approx(unknown[0], abs=0.01)


@pytest.mark.parametrize("gain", [0.85, 1.0, 1.2])
@pytest.mark.parametrize("jump", [0.065, -0.14])
def test_an_angle_that_jumps_alone_is_told_at_once(
    reference_model: Model, jump: float, gain: float
) -> None:
    """In fast motion, where a way of some milliseconds may be off by more for a wrong gain."""
    t = 1e-3 * np.arange(400)
    true = 30.0 + 100.0 * t
    angle = np.r_[0.0, np.cumsum(0.5 * (true[1:] + true[:-1]) * 1e-3)]
    assert told_at(reference_model, 0.0 * t, gain * true, angle + jump * (t >= 0.2)) in {200, 201}


@pytest.mark.parametrize("gain", [0.85, 1.0, 1.2])
@pytest.mark.parametrize("jump", [5.0, -3.0, 15.0])
def test_a_speed_that_jumps_alone_is_told(reference_model: Model, jump: float, gain: float) -> None:
    """At 30 rad/s, faster and faster; where the angle goes with the speed it was an impact."""
    t = 1e-3 * np.arange(400)
    true = 30.0 + 100.0 * t
    angle = np.r_[0.0, np.cumsum(0.5 * (true[1:] + true[:-1]) * 1e-3)]
    false = gain * true + jump * (t >= 0.2)
    assert told_at(reference_model, 0.0 * t, gain * true, angle) == -1
    assert 200 < told_at(reference_model, 0.0 * t, false, angle) <= 200 + 11
    hit = true + jump * (t >= 0.2)
    struck = np.r_[0.0, np.cumsum(0.5 * (hit[1:] + hit[:-1]) * 1e-3)]
    assert told_at(reference_model, 0.0 * t, gain * hit, struck) == -1


@pytest.mark.parametrize("lasts_ms", [2, 4, 8])
def test_a_short_spike_of_the_speed_is_told_by_the_angle(
    reference_model: Model, sweep_truth: Any, lasts_ms: int
) -> None:
    """It leaves no bend in the angle's way less the speed's, only a step."""
    whole, worst = series_of(sweep_truth), 0
    for at in range(6000, 30000, 1500):
        right = estimate(around(whole, at, 1500, 400), reference_model)
        lied = around(whole, at, 1500, 400)
        lied[NAMES[2]].value[1500 : 1500 + lasts_ms] -= 65.0
        trace = estimate(lied, reference_model)
        worst = max(worst, wrong_and_valid_ms(trace, right))
    assert worst <= 15
