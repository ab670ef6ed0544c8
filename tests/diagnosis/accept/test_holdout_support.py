"""Which effects hold where they were not fitted, and the model with them."""

from dataclasses import replace
from typing import Any

import pytest

from eps_hil.diagnosis.accept import holdout_support
from eps_hil.diagnosis.accept.holdout_support import _clear, augmented_by
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.discrepancy import Discrepancy
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.physics.model import Model

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("entry", "half", "expected"),
    [
        ({"effect": "inertia", "scale": 1.1}, {"scale": 0.05}, True),
        ({"effect": "inertia", "scale": 1.1}, {"scale": 0.2}, False),
        (
            {"effect": "stribeck", "level_nm": 0.1, "speed_rad_s": 5.0},
            {"level_nm": 0.2, "speed_rad_s": 20.0},
            True,  # they are hard to tell apart, not hard to see
        ),
        # near standstill every rig has a form of its own
        (
            {"effect": "stribeck", "level_nm": 0.02, "speed_rad_s": 2.0},
            {"level_nm": 0.008, "speed_rad_s": 0.3},
            False,
        ),
        (
            {"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 2.0},
            {"level_nm": 0.008, "speed_rad_s": 0.3},
            True,
        ),
        # the form of presliding is nobody's: what the balance alone shows of it has to be clearer
        ({"effect": "presliding_hysteresis", "sigma0_nm_per_rad": 3.0}, {"s": 0.7}, False),
        ({"effect": "presliding_hysteresis", "sigma0_nm_per_rad": 3.0}, {"s": 0.5}, True),
        ({"effect": "presliding_hysteresis", "sigma0_nm_per_rad": 5.5}, {"s": 0.7}, False),
        # of a rig that has none σ0 is any large number; the way over which it turns is nothing
        ({"effect": "presliding_hysteresis", "sigma0_nm_per_rad": 42.0}, {"s": 24.0}, True),
    ],
)
def test_one_number_that_may_as_well_be_nothing_is_no_finding(
    problem: Problem, entry: dict[str, Any], half: dict[str, float], expected: bool
) -> None:
    found = fit(problem, [entry], 0)
    found.__dict__["half_width"] = {(0, name): value for name, value in half.items()}
    assert _clear(problem, found, 0) is expected


def test_beside_something_unknown_a_name_has_to_be_clearer(problem: Problem) -> None:
    """Names that stand in for a part of what is unknown were up to 3.2 half widths from nothing."""
    found = fit(problem, [{"effect": "inertia", "scale": 1.1}], 0)
    found.__dict__["half_width"] = {(0, "scale"): 0.03}
    assert _clear(problem, found, 0)
    told = Discrepancy(problem, found.residual)
    remainder = told.whitening(told.evidence(found.residual, found.jacobian))
    assert not _clear(problem.beside(remainder), found, 0)
    found.__dict__["half_width"] = {(0, "scale"): 0.02}
    assert _clear(problem.beside(remainder), found, 0)


def test_what_only_made_up_for_another_is_no_finding_without_it(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    stribeck = {"effect": "stribeck", "level_nm": 0.02, "speed_rad_s": 10.0}
    drag = {"effect": "viscous_friction", "coefficient_nm_s_per_rad": -1e-4}
    found = fit(problem, [stribeck, drag], 0)
    found.__dict__["half_width"] = {(1, "coefficient_nm_s_per_rad"): 1e-3}
    gains = {"stribeck": 1e3, "viscous_friction": 1e3}
    selection = Selection(found, found, [], problem, found, gains=gains)
    vanished = fit(problem, [{**stribeck, "level_nm": 0.0}], 0)
    monkeypatch.setattr(holdout_support, "fit", lambda *_args, **_named: vanished)
    monkeypatch.setattr(holdout_support, "timed", lambda _problem, found: found)
    assert holdout_support._only_clear(problem, selection, [0, 1]) == []


@pytest.mark.parametrize("known", [True, False])
def test_a_stiffness_beside_far_more_that_is_unknown_is_a_part_of_it(
    problem: Problem, known: bool
) -> None:
    """One four times too small is worth a name; less so where friction lacks 0.03 Nm besides."""
    friction = problem.model.friction
    right = friction.sigma0_nm_per_rad
    bristle = {"effect": "presliding_hysteresis", "sigma0_nm_per_rad": right}
    stribeck = {"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 10.0}
    soft = replace(
        problem.model,
        friction=replace(friction, sigma0_nm_per_rad=0.25 * right),
        effects=(stribeck,) if known else (),
    )
    at = Problem(problem.recordings, replace(soft, effects=(*soft.effects, bristle)))
    found = fit(at, [], 0)
    assert not holdout_support.bristle_of_unknown(Problem(problem.recordings, soft), found)
    assert holdout_support.bristle_of_unknown(at, found) is not known


def test_the_model_with_findings_holds_no_other_entry_and_no_negative_delay(
    problem: Problem,
) -> None:
    entries = [
        {"effect": "stribeck", "level_nm": 0.0301234567, "speed_rad_s": 10.0},
        {"effect": "quadratic_drag", "coefficient_nm_s2_per_rad2": 1e-5},
    ]
    found = replace(fit(problem, entries, 0), own={"motor_torque_delay": 100.0})
    with_one = augmented_by(problem, found, [0])
    stribeck, later = with_one.effects
    assert stribeck == {"effect": "stribeck", "level_nm": 0.0301235, "speed_rad_s": 10.0}
    # reported before it acts: a model file has an effect for that, and no negative delay
    assert with_one.delays_s.motor_torque == 0.0
    given = problem.model.delays_s.motor_torque
    assert later == {"effect": "motor_torque_delay", "delay_s": pytest.approx(0.04 - given)}
    assert augmented_by(problem, found, []) is problem.model


@pytest.mark.parametrize(
    ("with_it", "without", "kept"),
    [(40.0, 20.0, False), (24.0, 20.0, True), (10.0, 20.0, True), (None, None, True)],
)
def test_a_bristle_that_spoils_the_rack_force_is_no_finding(
    problem: Problem,
    monkeypatch: pytest.MonkeyPatch,
    with_it: float | None,
    without: float | None,
    kept: bool,
) -> None:
    """Whatever else was found beside it stays."""
    entries = [
        {"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 10.0},
        {"effect": "presliding_hysteresis", "sigma0_nm_per_rad": 2.0},
    ]
    found = fit(problem, entries, 0)
    gains = {"stribeck": 1e3, "presliding_hysteresis": 1e3}
    selection = Selection(found, found, [], problem, found, gains=gains)

    def error(_judged: object, _common: Model, model: Model) -> float | None:
        changed = any(one["effect"] == "presliding_hysteresis" for one in model.effects)
        return with_it if changed else without

    monkeypatch.setattr(holdout_support, "rack_force_error_n", error)
    left = holdout_support._without_spoiling_bristle(problem, selection, [0, 1], [])
    assert left == ([0, 1] if kept else [0])
