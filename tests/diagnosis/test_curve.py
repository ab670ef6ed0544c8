"""A free curve over position: where its knots go and what it holds."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.baseline import ALL
from eps_hil.diagnosis.curve import ID, MOST_KNOTS, knots, with_curve
from eps_hil.diagnosis.fit import fit
from eps_hil.diagnosis.locate import coordinates
from eps_hil.diagnosis.prepare import prepare
from eps_hil.diagnosis.problem import Problem
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
