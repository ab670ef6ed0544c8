"""What no model explains is no noise: it is as large under every model, and noise gains nothing."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from eps_hil.diagnosis.balance.baseline import ALL
from eps_hil.diagnosis.balance.both_states import BothStates
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Floats, Problem
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.identification.butterworth import low_pass
from eps_hil.physics.model import Friction, Model
from eps_hil.series import Series

INERTIA, LEVEL_NM, DRAG = 0.02, 0.2, 0.02
SECONDS = 40
SPEED_NOISE, TORQUE_NOISE = 0.05, 0.01


def rotor(unknown_nm: float, seed: int = 1) -> Prepared:
    """A rotor alone that swings, and beside its friction a torque that follows nothing."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, 1e-3)
    speed: Floats = 6.0 * np.sin(2.0 * t) + 2.0 * np.sin(5.3 * t) + np.sin(9.1 * t)
    angle = np.cumsum(speed) * 1e-3
    unknown = low_pass(rng.standard_normal(len(t)), 6.0)
    unknown *= unknown_nm / np.std(unknown)
    torque = INERTIA * np.gradient(speed, 1e-3) + LEVEL_NM * np.sign(speed) + DRAG * speed + unknown
    return of_columns({
        "motor_angle_rad": angle + 1e-4 * rng.standard_normal(len(t)),
        "motor_speed_rad_s": speed + SPEED_NOISE * rng.standard_normal(len(t)),
        "motor_torque_nm": torque + TORQUE_NOISE * rng.standard_normal(len(t)),
    })  # fmt: skip


def of_columns(columns: Mapping[str, Floats]) -> Prepared:
    t_ns = np.arange(len(columns["motor_angle_rad"]), dtype=np.int64) * 1_000_000
    one = prepare("rotor", {name: Series(t_ns, values) for name, values in columns.items()})
    return one.changed(raw={**one.raw, "rack_force_n": np.zeros(len(one.time_s))})


def given() -> Model:
    """The right model, its inertia by a tenth too small."""
    friction = Friction(LEVEL_NM, LEVEL_NM, DRAG, DRAG, 0.0, 0.0, 40.0, 0.0, 0.75)
    return Model(
        inertia_kg_m2=0.9 * INERTIA,
        pinion_ratio_rad_per_m=100.0,
        rack_to_rotor_ratio_rad_per_m=1000.0,
        friction=friction,
    )


def refitted(problem: Problem) -> Model:
    problem.knee = 0.0
    return problem.with_entries([], fit(problem, [], own=ALL).own)


def test_an_inertia_gains_nothing_by_its_own_noise() -> None:
    """With noise alone for what is left it is twice as large as the rotor has."""
    problem = Problem([rotor(unknown_nm=0.3)], given())
    bent = refitted(problem)
    assert bent.inertia_kg_m2 > 2.0 * INERTIA
    assert problem.weigh(bent)
    found = refitted(problem)
    assert found.inertia_kg_m2 == pytest.approx(INERTIA, rel=0.15)
    problem.weigh(found)
    assert problem.beyond_nm == pytest.approx(0.3, rel=0.15)


def test_where_only_noise_is_left_nothing_changes() -> None:
    """The inertia is right for the noise of its acceleration, as errors in variables have it."""
    problem = Problem([rotor(unknown_nm=0.0)], given())
    found = refitted(problem)
    assert found.inertia_kg_m2 == pytest.approx(INERTIA, rel=0.02)
    columns = problem.columns
    assert not problem.weigh(found)
    assert problem.beyond_nm == 0.0
    assert problem.columns is columns


def test_what_is_left_is_weighed_by_noise_and_what_is_beyond() -> None:
    one, model = rotor(unknown_nm=0.0), given()
    heavier = replace(model, inertia_kg_m2=5.0 * INERTIA)
    small, large = one.floor_nm(model), one.floor_nm(heavier)
    assert large > 2.0 * small
    for beyond in (0.0, 0.05, 1.0):
        problem = Problem([one], model, beyond_nm=beyond)
        less = np.hypot(small, beyond) / np.hypot(large, beyond)
        np.testing.assert_allclose(problem.left(one, heavier), less * one.left_over(heavier))
        assert problem.over([one]).beyond_nm == problem.apart([one]).beyond_nm == beyond


def test_a_motor_that_takes_torque_off_is_no_better_for_what_is_left() -> None:
    """What is left of half the torque is half of it: no gain."""
    model = given()
    still = replace(model, inertia_kg_m2=1e-9, friction=Friction(*[1e-9] * 9))
    one = rotor(unknown_nm=0.3)
    half = replace(still, effects=({"effect": "motor_torque_gain", "gain": 0.5},))
    problem = Problem([one], still)
    assert problem.weigh(still)
    assert problem.beyond_nm > 0.1
    whole, less = (np.mean(problem.left(one, each) ** 2) for each in (still, half))
    assert less == pytest.approx(whole, rel=1e-3)


def test_what_two_states_leave_is_weighed_under_the_model_of_each() -> None:
    """What tells the states apart is nothing that is left."""
    one = rotor(unknown_nm=0.0, seed=2)
    offset_nm = 0.5
    pulled = {"effect": "motor_torque_offset", "offset_nm": offset_nm}
    torque = one.raw["motor_torque_nm"] - offset_nm
    moved = one.changed(name="moved", raw={**one.raw, "motor_torque_nm": torque})
    model = replace(given(), inertia_kg_m2=INERTIA)
    problem = BothStates([one, moved], model, known=frozenset({one.name}))
    assert not problem.weigh(problem.with_entries([pulled]))
    before = problem.left(one, problem.with_entries([pulled]))
    assert problem.weigh(problem.with_entries([]))
    assert problem.beyond_nm > 0.2
    np.testing.assert_allclose(problem.left(one, problem.with_entries([pulled])), before)
