"""What goes wrong in holes and beside them, and what holes cost a healthy rig."""

from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.batch import estimate
from eps_hil.estimation.stream import Trace
from eps_hil.estimation.validity import Reason
from eps_hil.physics.model import Model
from eps_hil.series import Series

from .false_signals import NAMES, SINCE, around, holed, series_of, told

TURNS_IN_HOLES = {
    "one of 16 ms": (slice(None, 15), 10, ((2, 16),), 2),
    "a little earlier": (slice(None, 15), 10, ((6, 16),), 2),
    "three short ones": (slice(-30, None), 8, ((4, 5), (12, 3), (24, 5)), 0),
}
"""Which turning points; the offset begins so many ms after them; holes (ms before, ms); the most
that may be missed."""


def test_many_gaps_at_rest_add_up_no_noise(reference_model: Model, steps_truth: Any) -> None:
    """Each gap in its turn is bridged by a noisy angle; all together by a filtered one."""
    whole = series_of(steps_truth)
    rng = np.random.default_rng(5)
    whole[NAMES[3]].value[:] += 2e-3 * rng.standard_normal(len(whole[NAMES[3]].t_ns))
    right = estimate(whole, reference_model)
    t_ns = whole[NAMES[0]].t_ns
    lost = (t_ns > 11_300 * 10**6) & (t_ns < 12_400 * 10**6) & (t_ns // 10**6 % 30 < 25)
    holes = {name: Series(t_ns[~lost], one.value[~lost]) for name, one in whole.items()}
    trace = estimate(holes, reference_model)
    at = (right.t_ns > 12_402 * 10**6) & (right.t_ns < 12_470 * 10**6)
    again = np.interp(right.t_ns[at], trace.t_ns, trace.rack_force_n)
    assert told(trace, 11_400, 12_300) & Reason.GAP
    assert np.max(np.abs(again - right.rack_force_n[at])) < 25.0


@pytest.mark.parametrize("offset_nm", [2.2, -2.2])
def test_what_began_in_a_hole_has_not_bent_the_bristle(
    reference_model: Model, steps_truth: Any, offset_nm: float
) -> None:
    """The rotor came to rest under a torque that was false since a hole; its end takes it back."""
    right = estimate(series_of(steps_truth), reference_model)
    for until in (3000, 3100, 3200, 3300, 5400, 8000, 11_300):
        series = series_of(steps_truth)
        series[NAMES[0]].value[until - 500 : until] += offset_nm
        trace = estimate(holed(series, until - 530, 35), reference_model)
        same = np.searchsorted(right.t_ns, trace.t_ns)
        wrong = np.abs(trace.rack_force_n - right.rack_force_n[same]) > 100.0
        assert np.count_nonzero(wrong & trace.valid & right.valid[same]) <= 20


def wrong_in_holes(trace: Trace, right: Trace) -> int:
    """Rows of ``trace`` more than 100 N from those of ``right`` of their instants, both valid."""
    same = np.searchsorted(right.t_ns, trace.t_ns)
    wrong = np.abs(trace.rack_force_n - right.rack_force_n[same]) > 100.0
    return int(np.sum(wrong & trace.valid & right.valid[same]))


def turning_points(whole: dict[str, Series]) -> Any:
    """Samples at which the speed changes its sign for longer than its noise does."""
    speed = np.convolve(whole[NAMES[2]].value, np.full(9, 1 / 9), "same")
    turns = 5000 + np.flatnonzero(speed[5000:-1000] * speed[4999:-1001] < 0.0)
    return turns[np.r_[True, np.diff(turns) > 40]]


@pytest.mark.parametrize("holes", TURNS_IN_HOLES)
def test_an_offset_that_begins_near_holes_in_which_the_rotor_turns_is_told(
    reference_model: Model, sweep_truth: Any, holes: str
) -> None:
    """The speed is drawn straight through a hole, but the friction turns over within it."""
    some, after_ms, lost, most = TURNS_IN_HOLES[holes]
    whole, missed = series_of(sweep_truth), 0
    turns = turning_points(whole)
    turns = turns[:: len(turns) // 15] if some.start is None else turns
    for turn in turns[some]:
        right = estimate(around(whole, turn, 3000, 400), reference_model)
        for offset_nm in (0.17, -0.17):
            lied = around(whole, turn, 3000, 400)
            lied[NAMES[0]].value[3000 + after_ms : 3160] += offset_nm
            at = int(lied[NAMES[0]].t_ns[3000] // 10**6)
            for before_ms, lost_ms in lost:
                lied = holed(lied, at - before_ms, lost_ms)
            missed += wrong_in_holes(estimate(lied, reference_model), right) > 20
    assert missed <= most


@pytest.mark.parametrize("lost_ms", [4, 7, 11, 16])
@pytest.mark.parametrize("offset_rad_s", [16.0, -30.0])
def test_a_speed_that_jumps_in_a_hole_is_told(
    reference_model: Model, sweep_truth: Any, lost_ms: int, offset_rad_s: float
) -> None:
    """The jump is drawn over the hole, by less from step to step than is looked at."""
    whole, missed = series_of(sweep_truth), 0
    for at in range(31000, 33000, 100):
        right = estimate(around(whole, at, 1500, 300), reference_model)
        lied = around(whole, at, 1500, 300)
        lied[NAMES[2]].value[1500:] += offset_rad_s
        begin = int(lied[NAMES[0]].t_ns[1500] // 10**6) - lost_ms // 2
        trace = estimate(holed(lied, begin, lost_ms), reference_model)
        missed += wrong_in_holes(trace, right) > 20
    assert missed <= 1


def test_a_torque_drawn_over_two_holes_is_not_believed(
    reference_model: Model, sweep_truth: Any
) -> None:
    """Two samples between holes of 14 ms show no course of a torque."""
    whole, missed = series_of(sweep_truth), 0
    for at in range(5000, 20000, 500):
        right = estimate(around(whole, at, 3000, 600), reference_model)
        lied = around(whole, at, 3000, 600)
        lied[NAMES[0]].value[3000:3250] -= 0.24
        at_ms = int(lied[NAMES[0]].t_ns[3000] // 10**6)
        trace = estimate(holed(holed(lied, at_ms - 14, 19), at_ms - 30, 14), reference_model)
        missed += wrong_in_holes(trace, right) > 20
    assert missed == 0


@pytest.mark.parametrize("lost_ms", [1, 3, 7, 17])
@pytest.mark.parametrize("offset_nm", [0.2, -2.0])
def test_what_began_in_a_short_hole_is_told_at_once(
    reference_model: Model, weave_truth: Any, lost_ms: int, offset_nm: float
) -> None:
    """Lost frames: the torque may have jumped while nobody looked."""
    right = estimate(series_of(weave_truth), reference_model)
    for since in (6400, SINCE, 12_100):
        for seen_of_it_ms in (0, lost_ms // 2, lost_ms - 1):
            series = series_of(weave_truth)
            series[NAMES[0]].value[since : since + 400] += offset_nm
            trace = estimate(holed(series, since - seen_of_it_ms, lost_ms), reference_model)
            same = np.searchsorted(right.t_ns, trace.t_ns)
            wrong = np.abs(trace.rack_force_n - right.rack_force_n[same]) > 100.0
            assert told(trace, since, since + 40) & Reason.INCONSISTENT
            assert np.count_nonzero(wrong & trace.valid) <= 20


@pytest.mark.parametrize("truth", ["sweep_truth", "weave_truth", "steps_truth"])
def test_short_holes_of_a_healthy_rig_cost_little(
    reference_model: Model, request: pytest.FixtureRequest, truth: str
) -> None:
    """Some of each kind: frames that are lost, and samples that are marked as bad."""
    whole = series_of(request.getfixturevalue(truth))
    before = estimate(whole, reference_model)
    rng, t_ns = np.random.default_rng(7), whole[NAMES[0]].t_ns
    kept = np.ones(len(t_ns), bool)
    for at in range(1000, len(t_ns) - 100, 97):
        kept[at : at + rng.integers(1, 18)] = False
    lost = {name: Series(t_ns[kept], one.value[kept]) for name, one in whole.items()}
    trace = estimate(lost, reference_model)
    assert told(trace, 500, 60_000) == told(before, 500, 60_000)
    assert np.mean(trace.valid) > np.mean(before.valid) - 0.01
    bad = range(3000, len(t_ns) - 1000, 1000)
    for at in bad:
        whole[NAMES[0]].value[at : at + 3] = np.nan
    trace = estimate(whole, reference_model)
    assert not np.any(trace.reason & int(Reason.INCONSISTENT))
    lost_ms = np.count_nonzero(before.valid) - np.count_nonzero(trace.valid)
    assert lost_ms < 200 * len(bad)


@pytest.mark.parametrize("lost_ms", [30, 300])
def test_what_may_have_begun_in_a_hole_is_waited_for(
    reference_model: Model, weave_truth: Any, lost_ms: int
) -> None:
    """Nobody saw the torque leave its course; only its return is seen."""
    right = estimate(series_of(weave_truth), reference_model)
    series = series_of(weave_truth)
    series[NAMES[0]].value[SINCE : SINCE + 700] += 0.2
    trace = estimate(holed(series, SINCE - lost_ms + 5, lost_ms), reference_model)
    same = np.searchsorted(right.t_ns, trace.t_ns)
    assert np.all(right.t_ns[same] == trace.t_ns)
    wrong = np.abs(trace.rack_force_n - right.rack_force_n[same]) > 100.0
    assert np.count_nonzero(wrong) > 300
    assert not np.any(wrong & trace.valid)
    assert told(trace, SINCE + 700 + 1900, SINCE + 700 + 2900) == Reason.FINE


def test_a_jump_just_before_a_hole_is_no_slope_within_it(
    reference_model: Model, sweep_truth: Any
) -> None:
    """The guess ran away with the jump's slope; coming back from it was one more jump."""
    lied = series_of(sweep_truth)
    lied[NAMES[0]].value[9000:9400] += 0.3
    kept = np.ones(len(lied[NAMES[0]].t_ns), bool)
    for lost in (slice(9002, 9005), slice(9007, 9010), slice(9012, 9017)):
        kept[lost] = False
    holes = {n: Series(one.t_ns[kept], one.value[kept]) for n, one in lied.items()}
    trace = estimate(holes, reference_model)
    assert told(trace, 9030, 9400) & Reason.INCONSISTENT
    assert told(trace, 11_400, 12_400) == Reason.FINE


@pytest.mark.parametrize("offset_nm", [-4.4, 1.0])
def test_a_spike_between_lost_frames_is_taken_back(
    reference_model: Model, weave_truth: Any, offset_nm: float
) -> None:
    """Single samples with lost ones on either side: nothing is seen of a course there."""
    right = estimate(series_of(weave_truth), reference_model)
    for since in (6400, SINCE, 12_100):
        series = series_of(weave_truth)
        series[NAMES[0]].value[since : since + 4] += offset_nm
        for lost_ms in (-1, 1, 3, 5):
            series = holed(series, since + lost_ms, 1)
        trace = estimate(series, reference_model)
        same = np.searchsorted(right.t_ns, trace.t_ns)
        wrong = np.abs(trace.rack_force_n - right.rack_force_n[same]) > 100.0
        assert np.count_nonzero(wrong & trace.valid & right.valid[same]) <= 15
