"""A free curve over position: where its knots go and what it holds."""

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance.baseline import ALL, OFFSET, OFFSET_NM
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.mismatch import curve
from eps_hil.diagnosis.mismatch.curve import ID, MOST_KNOTS, knots, levelled, winds, with_curve
from eps_hil.diagnosis.mismatch.locate import coordinates
from eps_hil.physics.model import Model
from eps_hil.series import Series

pytestmark = pytest.mark.slow

CENTRE_M, WIDTH_M, PEAK_NM = 0.003, 0.002, 0.02


def problem_of(recordings: Mapping[str, Any], model: Model) -> Problem:
    return Problem([prepare(name, one) for name, one in recordings.items()], model)


@pytest.fixture(scope="module")
def clean(record: Callable[..., Any], reference_model: Model) -> Problem:
    return problem_of(record({}, seconds=12.0), reference_model)


def bump_nm(position_m: Any) -> Any:
    return PEAK_NM * np.exp(-(((position_m - CENTRE_M) / WIDTH_M) ** 2))


def test_knots_crowd_where_the_profile_bends(clean: Problem) -> None:
    rng = np.random.default_rng(1)
    place = coordinates(clean)["rack_position_m"]
    residual = rng.standard_normal(len(place)) + bump_nm(place) / clean.scale
    found = np.array(knots(clean, residual))
    assert 4 <= len(found) <= MOST_KNOTS
    assert np.all(np.diff(found) > 0)
    near = np.abs(found - CENTRE_M) < 3 * WIDTH_M
    low, high = clean.visited_m
    assert np.mean(near) > 2.0 * 6 * WIDTH_M / (high - low)
    drawn = np.interp(place, found, bump_nm(found))
    assert np.max(np.abs(drawn - bump_nm(place))[clean.sliding]) < 0.25 * PEAK_NM


def test_the_rarely_visited_ends_are_drawn_too(clean: Problem) -> None:
    """A curve that ended where most of the way does would be flat beyond."""
    rng = np.random.default_rng(5)
    place = coordinates(clean)["rack_position_m"]
    low, high = (float(one) for one in np.percentile(place[clean.sliding], [20, 80]))
    mostly = copy(clean)
    mostly.visited_m = (low, high)
    kinked = 2e4 * np.maximum(place - high, 0.0)
    found = knots(mostly, rng.standard_normal(len(place)) + kinked)
    assert len(found) > 2
    assert found[0] < low
    assert found[-1] > high


def test_noise_and_straight_lines_need_no_knots(clean: Problem) -> None:
    rng = np.random.default_rng(2)
    place = coordinates(clean)["rack_position_m"]
    noise = rng.standard_normal(len(place))
    assert len(knots(clean, noise)) == 2
    assert len(knots(clean, noise + 100.0 * place)) == 2


def test_nothing_to_draw_leaves_the_fit_as_it_is(clean: Problem) -> None:
    found = fit(clean, [], own=ALL)
    assert with_curve(clean, found) is found


def test_a_curve_is_solved_beside_the_rest_and_holds_no_constant(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """A bump that the motor works against, and an offset, which stays outside of the curve."""
    recordings = {}
    for name, one in record({other_rig.EM_OFF: 0.01}, seconds=12.0).items():
        torque, place = one["motor_torque_nm"], one["rack_position_m"]
        bump = bump_nm(np.interp(torque.t_ns, place.t_ns, place.value))
        recordings[name] = {**one, "motor_torque_nm": Series(torque.t_ns, torque.value + bump)}
    problem = problem_of(recordings, reference_model)
    found = fit(problem, [], own=ALL)
    for _ in range(2):  # as the selection does: the first curve lets the rest find its place
        found = with_curve(problem, found)
    (entry,) = found.entries
    assert entry["effect"] == ID
    way = np.linspace(*problem.visited_m, 200)
    drawn = np.interp(way, *np.array(entry["curve"]).T)
    wrong = drawn - bump_nm(way)
    assert np.sqrt(np.mean(wrong**2)) < 0.05 * PEAK_NM
    assert np.median(np.abs(wrong)) < 0.01 * PEAK_NM
    # the friction levels of both directions share the offset, by their priors
    assert 0.02 * found.own["motor_torque_offset"] == pytest.approx(0.01, rel=0.3)


def test_the_second_step_puts_right_what_the_first_took_beside_a_bent_model(
    record: Callable[..., Any],
    reference_model: Model,
    other_rig: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A bump ten times as high, and a Stribeck effect that the refit without the bump bends."""
    plant = {other_rig.STRIB: 0.03, other_rig.STRIB_W: 10.0}
    recordings = {}
    for name, one in record(plant, seconds=12.0).items():
        torque, place = one["motor_torque_nm"], one["rack_position_m"]
        bump = 10.0 * bump_nm(np.interp(torque.t_ns, place.t_ns, place.value))
        recordings[name] = {**one, "motor_torque_nm": Series(torque.t_ns, torque.value + bump)}
    problem = problem_of(recordings, reference_model)
    stribeck = {"effect": "stribeck", "level_nm": 0.01, "speed_rad_s": 5.0}
    bent = fit(problem, [stribeck], own=ALL)
    costs = []
    for steps in (1, 2, 3):
        monkeypatch.setattr(curve, "_STEPS", steps)
        costs.append(with_curve(problem, bent).cost)
    assert costs[1] < 0.9 * costs[0]
    assert costs[1] < 1.05 * costs[2]


@pytest.fixture
def one_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """For residuals that were made up: the next step would see the recordings' own."""
    monkeypatch.setattr(curve, "_STEPS", 1)


def test_a_strong_curve_is_not_cut_as_an_outlier(clean: Problem, one_step: None) -> None:
    """A hundred times the noise: its own height is no outlier, and single samples still are."""
    rng = np.random.default_rng(4)
    place = coordinates(clean)["rack_position_m"]
    residual = rng.standard_normal(len(place)) + 10.0 * bump_nm(place) / clean.scale
    residual[::97] += 500.0
    base = fit(clean, [], own=ALL)
    entry = with_curve(clean, replace(base, residual=residual)).entries[0]
    x, y = np.array(entry["curve"]).T
    drawn = np.interp(place, x, y)
    error = drawn - 10.0 * bump_nm(place)
    error -= np.median(error[clean.sliding])
    assert np.max(np.abs(error[clean.sliding])) < 0.15 * 10.0 * PEAK_NM


def test_where_the_rack_seldom_was_a_strong_curve_is_no_outlier_either(
    clean: Problem, one_step: None
) -> None:
    """A few fast passes: the cells are as wide as it takes to have a median."""
    place = coordinates(clean)["rack_position_m"]
    low, high = np.min(place[clean.sliding]), np.max(place[clean.sliding])
    stretched = copy(clean)  # as if most of the way had been passed forty times as fast
    end = float(np.percentile(place[clean.sliding], 99.0))
    stretched.sliding = clean.sliding & ((place > end) | (np.arange(len(place)) % 40 == 0))
    _, cell = curve._cells(stretched)
    assert np.min(np.bincount(cell[stretched.sliding])[:-1]) >= 4
    assert np.max(cell) < 360
    rng = np.random.default_rng(6)
    ramp_nm = 0.2 + 0.2 * (place - low) / (high - low)
    residual = rng.standard_normal(len(place)) + ramp_nm / clean.scale
    cut = curve._without_outliers(stretched, residual)
    use = stretched.sliding & (place < end)
    assert np.max(np.abs(cut - residual)[use]) < 0.1 * np.max(residual[use])


def test_a_span_in_which_no_knot_helps_keeps_none_from_the_others() -> None:
    place = np.linspace(0.0, 1.0, 200)
    left = np.where(place < 0.5, 3.0, 1.0)
    worst, next_worst = curve._trials([0.0, 0.5, 0.9, 1.0], place, left, 50.0)
    assert max(worst) < 0.5 < min(next_worst) < max(next_worst) < 0.9


def test_a_number_that_nothing_depends_on_does_not_spoil_the_curve(
    clean: Problem, one_step: None
) -> None:
    """Sensitivities that have died out (a dwell without a level) are a column of zeros."""
    place = coordinates(clean)["rack_position_m"]
    rng = np.random.default_rng(5)
    residual = rng.standard_normal(len(place)) + bump_nm(place) / clean.scale
    base = replace(fit(clean, [], own=ALL), residual=residual)
    dead = np.zeros((len(residual), 1))
    beside = replace(base, jacobian=np.hstack([base.jacobian, dead]))
    expected = np.array(with_curve(clean, base).entries[0]["curve"])
    found = np.array(with_curve(clean, beside).entries[0]["curve"])
    assert found == pytest.approx(expected, abs=1e-9)


def test_a_constant_is_the_level_of_a_curve_unless_the_curve_keeps_clear_of_zero(
    clean: Problem,
) -> None:
    bump = [[0.001 * k, float(bump_nm(0.001 * k))] for k in range(-8, 9)]
    entries = [{"effect": ID, "curve": bump}]
    for share, folded in ((0.05, True), (-0.5, True), (-1.5, False), (0.5, False)):
        offset = -share * PEAK_NM / OFFSET_NM
        found = fit(clean, entries, 0, {OFFSET: offset})
        raised = levelled(clean, found)
        assert (raised is not None) == folded
        if raised is not None:
            assert OFFSET not in raised.own
            assert raised.entries[0]["curve"][0][1] == pytest.approx(
                bump[0][1] + share * PEAK_NM, abs=1e-12
            )
            assert raised.residual == pytest.approx(found.residual, abs=0.02)


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (lambda x: np.exp(-(x**2) / 0.1), False),
        (lambda x: np.sin(np.pi * x), False),
        (lambda x: x, False),
        (lambda x: np.sin(6 * np.pi * x), True),
        (lambda x: np.exp(-(x**2) / 0.1) + 0.1 * np.sin(40 * x), False),
    ],
)
def test_what_goes_to_and_fro_is_no_place(shape: Callable[[Any], Any], expected: bool) -> None:
    x = np.linspace(-1.0, 1.0, 60)
    drawn = [[a, b] for a, b in zip(x, shape(x), strict=True)]
    assert winds({"curve": drawn}, (-1.0, 1.0)) == expected
    assert not winds({"level_nm": 0.1}, (-1.0, 1.0))


def test_what_lies_where_hardly_anything_was_is_no_swing() -> None:
    waves = [[0.1 * k, float(k % 2)] for k in range(-10, 11)]
    assert winds({"curve": waves}, (-1.0, 1.0))
    assert not winds({"curve": waves}, (-0.15, 0.15))
