"""Where candidates come from: orders of a turn, and which may stand beside what is there."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.probes import Candidate, _clear_orders, bounds, candidates, hats
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model


@pytest.fixture(scope="module")
def turning() -> tuple[np.ndarray, np.ndarray]:
    """Angle (rad) and speed (rad/s) of sweeps that speed up and slow down, 125 Hz."""
    t = np.arange(5000) / 125.0
    speed = 12.0 + 10.0 * np.sin(0.3 * t)
    return np.cumsum(speed) / 125.0, speed


@pytest.mark.parametrize("strong", [1.0, 30.0])
def test_a_weak_order_is_found_beside_a_strong_one(
    turning: tuple[np.ndarray, np.ndarray], strong: float
) -> None:
    """Whose skirts are higher than it, a few orders away."""
    phi, omega = turning
    noise = np.random.default_rng(1).normal(0.0, 0.3, len(phi))
    left = strong * np.sin(6.02 * phi + 0.2) + np.sin(8.0 * phi) + np.cos(3.5 * phi) + noise
    orders = _clear_orders(left, phi, omega)
    assert sorted(orders[:3]) == pytest.approx([3.5, 6.02, 8.0], abs=0.01)
    assert min(np.diff(sorted(orders))) > 0.3


@pytest.mark.parametrize("order", [0.47, 0.5, 100.0, 100.04])
def test_orders_stay_within_what_is_looked_for(order: float) -> None:
    phi = np.cumsum(np.full(5000, 2.0)) / 125.0
    (first, *_) = _clear_orders(np.sin(order * phi), phi, np.full(5000, 2.0))
    assert first == pytest.approx(order, abs=0.05)
    assert 0.5 <= first <= 100.0


def low_passed(phi: np.ndarray, omega: np.ndarray, order: float) -> np.ndarray:
    """A ripple as the balance's filter shows it, which has half of it at 40 Hz."""
    return np.sin(order * phi + 0.7) / (1.0 + (omega * order / (2 * np.pi * 40.0)) ** 8)


@pytest.mark.parametrize("order", [24.0, 36.0, 60.0])
def test_an_order_is_found_that_is_heard_around_reversals_only(order: float) -> None:
    """Strokes of 20 to 30 rad: of order 60 the filter passes a sample in fourteen."""
    t = np.arange(10_000) / 125.0
    phi = (25.0 + 5.0 * np.sin(0.3 * t)) * np.sin(1.57 * t)
    omega = np.abs(np.gradient(phi, t))
    left = low_passed(phi, omega, order) + np.random.default_rng(2).normal(0.0, 0.3, len(t))
    first, *_ = _clear_orders(left, phi, omega)
    assert first == pytest.approx(order, abs=0.01)


def test_a_weak_order_is_found_over_many_turns() -> None:
    """From lock to lock: orders 0.05 apart are 36 periods apart over 4500 rad."""
    t = np.arange(60_000) / 125.0
    phi, omega = 9.4 * t, np.full(len(t), 9.4)
    noise = np.random.default_rng(3).normal(0.0, 1.0, len(t))
    first, *_ = _clear_orders(0.05 * low_passed(phi, omega, 7.326) + noise, phi, omega)
    assert first == pytest.approx(7.326, abs=0.0005)


def test_an_order_is_one_term_more_only_away_from_those_there(reference_model: Model) -> None:
    cogging = Candidate(catalogue()["cogging_torque"], {"order": 12.0}, np.zeros((1, 2)))
    drag = Candidate(catalogue()["viscous_friction"], {}, np.zeros((1, 1)))
    other = {"effect": "stribeck"}
    six, near = ({"effect": "cogging_torque", "order": order} for order in (6.0, 11.9))
    assert cogging.beside([], reference_model)
    assert cogging.beside([other, six], reference_model)
    assert not cogging.beside([six, near], reference_model)
    assert not cogging.beside([six] * 4, reference_model)  # a model file holds no more…
    held = replace(reference_model, effects=({**near, "amplitude_nm": 0.01, "phase_rad": 0.0},) * 2)
    assert cogging.beside([six], held)  # of what the model has there may be too much
    assert not cogging.beside([six] * 2, held)  # …its own ones included
    assert drag.beside([other], reference_model)
    assert not drag.beside([{"effect": "viscous_friction"}], reference_model)


def test_what_a_model_has_no_room_for_is_not_looked_for(
    record: Callable[..., Any], reference_model: Model
) -> None:
    cog = {"effect": "cogging_torque", "order": 6.0, "amplitude_nm": 1e-3, "phase_rad": 0.0}
    model = replace(reference_model, effects=tuple({**cog, "order": k} for k in (6.0, 7, 8, 9)))
    (made,) = record({}, ("weave",), seconds=8.0).values()
    problem = Problem([prepare("weave", made)], model)
    pool = candidates(problem, [], problem.residual(model))
    assert {"stribeck", "torque_ripple"} <= {one.effect.id for one in pool}
    assert "cogging_torque" not in {one.effect.id for one in pool}


def test_a_curve_over_position_is_made_while_sliding_only(problem: Problem) -> None:
    """At rest friction holds whatever torque there is; a place would be told by its dwells."""
    residual = problem.residual(problem.model)
    low, high = problem.visited_m
    places = np.linspace(low, high, 5).tolist()
    columns = hats(problem, ([], {}), catalogue()["position_torque"], places, residual)
    resting = ~problem.sliding
    assert np.any(resting)
    assert not np.any(columns[resting])
    assert np.all(np.any(columns[problem.sliding], axis=0))


@pytest.mark.slow
def test_friction_does_not_fall_with_the_load(problem: Problem) -> None:
    effect = catalogue()["load_dependent_friction"]
    (gain,) = effect.parameters
    low, high = bounds(effect, gain, problem)
    friction = problem.model.friction
    assert low == -min(friction.load_pos_nm_per_n, friction.load_neg_nm_per_n)
    assert high == gain.upper


def test_drag_does_not_drive(problem: Problem) -> None:
    """Less than none at all cannot be missing; what a model file holds can be."""
    effect = catalogue()["viscous_friction"]
    (coefficient,) = effect.parameters
    friction = problem.model.friction
    own = min(friction.viscous_pos_nm_s_per_rad, friction.viscous_neg_nm_s_per_rad)
    assert bounds(effect, coefficient, problem) == (-own, coefficient.upper)
    held = {"effect": effect.id, coefficient.name: 3e-4}
    more = replace(problem, model=replace(problem.model, effects=(held,)))
    assert bounds(effect, coefficient, more)[0] == pytest.approx(-own - 3e-4)


@pytest.mark.slow
def test_what_fades_many_times_more_slowly_than_was_recorded_is_another_level(
    problem: Problem,
) -> None:
    effect = catalogue()["friction_warmup"]
    _, time = effect.parameters
    longest = max(float(one.time_s[-1]) for one in problem.recordings)
    low, high = bounds(effect, time, problem)
    assert low == time.lower
    assert high == pytest.approx(4.0 * longest)
    known = {"effect": effect.id, "amplitude": 0.2, "time_s": 900.0}
    model = replace(problem.model, effects=(known,))
    held = Problem(problem.recordings, model)
    assert bounds(effect, time, held) == (time.lower, time.upper)


def test_a_place_may_count_from_anywhere(problem: Problem) -> None:
    """Half a metre away it is looked for where the rack was, and moved by parts of its width."""
    moved = [
        one.changed(raw={**one.raw, "rack_position_m": one.raw["rack_position_m"] + 0.5})
        for one in problem.recordings
    ]
    far = Problem(moved, problem.model)
    place = catalogue()["position_dependent_friction"]
    (centre,) = (one for one in place.parameters if one.name == "centre_m")
    low, high = bounds(place, centre, far)
    assert (low, high) == pytest.approx(far.visited_m)
    entry = {"effect": place.id, "level_nm": 0.02, "centre_m": 0.503, "width_m": 2e-3}
    here = {**entry, "centre_m": 0.003}
    one, other = fit(far, [entry], 0), fit(problem, [here], 0)
    assert one.jacobian == pytest.approx(other.jacobian, rel=1e-3, abs=1e-3 * np.max(one.jacobian))
