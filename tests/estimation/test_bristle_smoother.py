"""The smoother: against independent derivations, and never wrong and valid where live is not."""

from typing import Any

import numpy as np
import pytest

from eps_hil.estimation import bristle_smoother
from eps_hil.estimation.batch import estimate, events, sample_periods_s
from eps_hil.estimation.bristle_filter import unknown_torque_nm
from eps_hil.estimation.bristle_setup import BRISTLE, OMEGA, PHI, SIZE
from eps_hil.estimation.bristle_smoother import smooth
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.validity import Reason
from eps_hil.physics.friction import friction_law
from eps_hil.physics.model import Model
from eps_hil.series import Series

from .recorded import INPUTS, recorded
from .truths import ANGLE, series_of

FILTER, SMOOTHER = EstimatorSettings(kind="bristle_filter"), EstimatorSettings(kind="smoother")


def test_innovations_are_as_large_as_they_should_be(
    reference_model: Model, sweep_truth: Any
) -> None:
    """Consistency: with the recording's own noise set, squared innovations average about one."""
    settings = EstimatorSettings(torque_noise_nm=3e-3, angle_noise_rad=1.1e-3)
    series = series_of(sweep_truth, ANGLE)
    found = smooth(reference_model, settings, sample_periods_s(series), events(series))
    speed, angle = np.nanmean(found.nis[500:], axis=0)
    assert 0.85 < speed < 1.15
    assert 0.85 < angle < 1.15


def test_smoothing_in_blocks_is_smoothing(
    reference_model: Model, weave_truth: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    series = series_of(weave_truth, ANGLE, 9000)
    whole = estimate(series, reference_model, SMOOTHER)
    monkeypatch.setattr(bristle_smoother, "BLOCK_STEPS", 2500)
    monkeypatch.setattr(bristle_smoother, "AHEAD_STEPS", 4000)
    cut = estimate(series, reference_model, SMOOTHER)
    assert np.array_equal(whole.t_ns, cut.t_ns)
    assert np.max(np.abs(whole.rack_force_n - cut.rack_force_n)) < 1.0


def test_what_is_unknown_is_that_of_rauch_tung_and_striebel(reference_model: Model) -> None:
    """Smoothed variances of the deflection by their recursion, on a random linear system."""
    rng, n, starts = np.random.default_rng(3), 60, 25
    room = bristle_smoother._room(n)
    noise, ahead = np.diag([1e-6, 1e-2, 1e-8, 1.0, 10.0]), np.zeros((n, SIZE, SIZE))
    for k in range(n):
        a = np.eye(SIZE) + 0.05 * rng.standard_normal((SIZE, SIZE))
        start = k in (0, starts)
        room.kind[k] = bristle_smoother._START if start else bristle_smoother._STEP
        p = np.diag([1e-4, 0.1, 1e-3, 100.0, 10.0]) if start else a @ room.cov[k - 1] @ a.T + noise
        room.jacobian[k], ahead[k] = a, p
        for which, i in enumerate((OMEGA, PHI)):
            room.spread[k, which] = p[i, i] + (0.1, 1e-6)[which]
            room.gain[k, which] = p[i] / room.spread[k, which]
            p = p - np.outer(room.gain[k, which], p[i])
        room.cov[k] = p
    room.extra[:, 2] = 1.0
    out, law = np.empty((n, 3)), friction_law(reference_model.friction)
    bristle_smoother._backward(True, law, room, n, out)
    expected, later = [], room.cov[-1]
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            back = room.cov[k] @ room.jacobian[k + 1].T @ np.linalg.inv(ahead[k + 1])
            told = room.cov[k] + back @ (later - ahead[k + 1]) @ back.T
            later = room.cov[k] if k + 1 == starts else told
        expected.append(unknown_torque_nm(law, later[BRISTLE, BRISTLE]))
    assert out[:, 2] == pytest.approx(expected[::-1], rel=1e-6)


def test_a_clock_that_jumps_by_decades_asks_for_no_room(
    reference_model: Model, weave_truth: Any
) -> None:
    """The smoother wanted 12 TiB for the steps that were not in the recording."""
    alone = series_of(weave_truth, ANGLE, 3000)
    jump_ns = 50 * 365 * 86_400 * 10**9
    both = {
        name: Series(np.concatenate([one.t_ns, one.t_ns + jump_ns]), np.tile(one.value, 2))
        for name, one in alone.items()
    }
    first, trace = (estimate(one, reference_model, SMOOTHER) for one in (alone, both))
    later = trace.t_ns > jump_ns // 2
    assert np.count_nonzero(~later) == pytest.approx(len(first.t_ns), abs=2)
    assert np.count_nonzero(later) > 2900
    assert np.mean(trace.valid[later][1500:]) > 0.9
    at_ns, same, twin = np.intersect1d(first.t_ns, trace.t_ns[later] - jump_ns, return_indices=True)
    late = at_ns > 1_500_000_000
    off = trace.rack_force_n[later][twin][late] - first.rack_force_n[same][late]
    assert np.max(np.abs(off)) < 20.0


@pytest.mark.parametrize(("off", "begin_s"), [(0.5, 15.3), (1.0, 6.0), (2.0, 6.0)])
def test_the_smoother_believes_nothing_beside_a_doubt(off: float, begin_s: float) -> None:
    """A speed that is off by little is doubted now and then: between and beside the doubts up to
    25 ms were 380 N wrong and valid, where nothing live was."""
    rig, speed = recorded("demo"), "motor_speed_rad_s"
    false = rig.signals[speed] + off * ((rig.time_s >= begin_s) & (rig.time_s < begin_s + 1.0))
    right, wrong = (
        estimate(
            {n: Series(rig.t_ns, v) for n, v in (rig.signals | changed).items() if n in INPUTS},
            rig.model, SMOOTHER,
        )
        for changed in ({}, {speed: false})
    )  # fmt: skip
    assert np.array_equal(right.t_ns, wrong.t_ns)
    assert np.any(wrong.reason & int(Reason.INCONSISTENT))
    apart = np.abs(wrong.rack_force_n - right.rack_force_n) > 100.0
    assert np.any(apart)
    assert not np.any(apart & wrong.valid & right.valid)
    far = np.abs((wrong.t_ns - rig.t_ns[0]) * 1e-9 - begin_s - 0.5) > 0.8
    assert np.array_equal(wrong.valid[far], right.valid[far])


@pytest.mark.parametrize("off", [0.05, -0.05, 0.3])
def test_a_bristle_that_slid_later_is_not_known_before(off: float) -> None:
    """A false step of the angle at rest makes it unknown. The sliding a second later forgets what
    it was, and tells little of it: 145 N wrong, and valid, until then."""
    rig, angle = recorded("demo"), "motor_angle_rad"
    false = rig.signals[angle] + off * (rig.time_s >= 21.0)
    right, wrong, live = (
        estimate(
            {n: Series(rig.t_ns, v) for n, v in (rig.signals | changed).items() if n in INPUTS},
            rig.model, settings,
        )
        for changed, settings in (
            ({}, SMOOTHER), ({angle: false}, SMOOTHER), ({angle: false}, FILTER)
        )
    )  # fmt: skip
    apart = np.abs(wrong.rack_force_n - right.rack_force_n) > 100.0
    assert np.count_nonzero(apart) > 500
    assert not np.any(apart & wrong.valid)
    time_s = (wrong.t_ns - rig.t_ns[0]) * 1e-9
    rests = (time_s > 21.1) & (time_s < 21.95)
    assert np.all(wrong.reason[rests] & int(Reason.FRICTION_UNKNOWN))
    assert np.all(wrong.valid[(time_s > 0.5) & (time_s < 20.8) | (time_s > 22.1)])
    lost = np.count_nonzero(~wrong.valid[time_s > 1.0])
    assert lost < np.count_nonzero(~live.valid[live.t_ns > rig.t_ns[0] + 10**9]) + 60


def test_behind_a_doubt_at_rest_the_smoother_has_the_bristle_of_the_filter() -> None:
    """An angle that jumped for 24 ms, and back, bent the smoother's alone: 100 N, and valid, until
    the rotor slid 1.3 s later."""
    rig, angle = recorded("demo"), "motor_angle_rad"
    jumped = (rig.time_s >= 22.566) & (rig.time_s < 22.590)
    right, wrong = (
        estimate(
            {n: Series(rig.t_ns, v) for n, v in (rig.signals | changed).items() if n in INPUTS},
            rig.model, SMOOTHER,
        )
        for changed in ({}, {angle: rig.signals[angle] - 0.21 * jumped})
    )  # fmt: skip
    time_s = (wrong.t_ns - rig.t_ns[0]) * 1e-9
    rests = (time_s > 22.8) & (time_s < 23.9)
    assert np.any(wrong.reason & int(Reason.INCONSISTENT))
    assert np.all(wrong.valid[rests])
    assert np.max(np.abs(wrong.rack_force_n - right.rack_force_n)[rests]) < 40.0


def test_a_recording_that_begins_at_rest_begins_unknown() -> None:
    """At a load of 1000 N that friction helps to hold it was over 40 N wrong, and valid."""
    rig = recorded("demo")
    late = rig.time_s >= 21.0
    series = {n: Series(rig.t_ns[late], rig.signals[n][late]) for n in INPUTS}
    trace = estimate(series, rig.model, SMOOTHER)
    error, time_s = trace.rack_force_n - rig.load_n(trace), (trace.t_ns - rig.t_ns[0]) * 1e-9
    rests = (time_s > 21.1) & (time_s < 21.9)
    assert np.all(np.abs(error[rests]) > 40.0)
    assert not np.any(trace.valid[rests])
    assert np.mean(trace.valid[time_s > 22.08]) == 1.0
