"""A slow joint that rests and moves by jerks, its speed coarse: whether it slides is no matter of
rate, gear or a little noise."""

import numpy as np
import pytest

from eps_hil.diagnosis.balance.baseline import ALL
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem, sliding
from eps_hil.diagnosis.balance.resting import problem_of
from eps_hil.diagnosis.data.noise import noise_of, quiet_noise_of
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.data.size import size_of
from eps_hil.physics.model import Friction, Model
from eps_hil.series import Series

LEVEL_NM, DRAG, INERTIA, SECONDS = 0.5, 0.3, 0.01, 90
ANGLE_STEP, SPEED_STEP, TORQUE_STEP = 4e-4, 0.022, 0.0024


def moves(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(angle, speed, torque), 1 kHz: quick moves to places and back; a torque held in each rest."""
    rng = np.random.default_rng(seed)
    speed, held = np.zeros(0), np.zeros(0)
    while len(speed) < 1000 * SECONDS:
        n, rest = int(rng.integers(300, 1200)), int(rng.integers(300, 1200))
        size = rng.uniform(0.2, 0.5) * (1.0 if np.sum(speed) < 0.0 else -1.0)
        t = np.arange(n)
        move = size * np.minimum(1.0, np.minimum(t, n - 1 - t) / 15.0)
        speed = np.concatenate([speed, move, np.zeros(rest)])
        held = np.concatenate([held, np.zeros(n), np.full(rest, rng.uniform(-0.9, 0.9) * LEVEL_NM)])
    torque = LEVEL_NM * np.sign(speed) + DRAG * speed + INERTIA * np.gradient(speed, 1e-3) + held
    return np.cumsum(speed) * 1e-3, speed, torque


def recorded(model: Model, seed: int = 3, every: int = 20, gear: float = 1.0) -> Prepared:
    """As a bus reports it, every so many ms, behind another gear."""
    columns = moves(seed)
    steps = ANGLE_STEP, SPEED_STEP, TORQUE_STEP
    names = "motor_angle_rad", "motor_speed_rad_s", "motor_torque_nm"
    factors = gear, gear, 1.0 / gear
    t_ns = np.arange(0, len(columns[0]), every, dtype=np.int64) * 1_000_000
    one = prepare("joint", {
        name: Series(t_ns, factor * step * np.round(values[::every] / step))
        for name, values, step, factor in zip(names, columns, steps, factors, strict=True)
    })  # fmt: skip
    return one.changed(size=size_of([one], model))


def rough(gear: float = 1.0) -> Model:
    """The model file that one would write: everything to one digit or worse."""
    friction = Friction(0.3 / gear, 0.3 / gear, 0.5 / gear**2, 0.5 / gear**2, 0.0, 0.0,
                        15.0 / gear**2, 0.0, 0.75)  # fmt: skip
    return Model(
        inertia_kg_m2=0.02 / gear**2,
        pinion_ratio_rad_per_m=100.0,
        rack_to_rotor_ratio_rad_per_m=1000.0,
        friction=friction,
    )


def slides_s(one: Prepared, model: Model) -> float:
    """Seconds in which it is known to slide."""
    return 8e-3 * float(np.sum(sliding(one, model)))


def test_white_noise_is_as_large_where_it_is_quietest() -> None:
    noise = 0.3 * np.random.default_rng(5).standard_normal(20_000)
    assert quiet_noise_of(noise) == pytest.approx(0.3, rel=0.08)


@pytest.mark.parametrize("every", [20, 30])
def test_quick_motion_between_samples_is_no_noise(every: int) -> None:
    coarse = SPEED_STEP * np.round(moves(3)[1][::every] / SPEED_STEP)
    assert quiet_noise_of(coarse) == pytest.approx(SPEED_STEP / np.sqrt(12.0), rel=0.3)
    assert noise_of(coarse) > 2.0 * quiet_noise_of(coarse)


@pytest.mark.parametrize("gear", [1.0, 20.0])
@pytest.mark.parametrize("every", [2, 5, 10, 20])
def test_it_slides_as_long_at_any_rate_and_behind_any_gear(every: int, gear: float) -> None:
    usual = slides_s(recorded(rough(), every=5), rough())
    assert usual > 10.0
    assert slides_s(recorded(rough(gear), every=every, gear=gear), rough(gear)) == pytest.approx(
        usual, rel=0.2
    )


def test_what_a_rest_holds_bends_no_level() -> None:
    model = rough()
    recording = recorded(model).as_measured()
    recording = recording.changed(
        raw={**recording.raw, "rack_force_n": np.zeros(len(recording.time_s))}, load_is_assumed=True
    )
    found = {}
    for name, problem in (
        ("held", problem_of([recording], model)),
        ("independent", Problem([recording], model)),
    ):
        own = fit(problem, [], own=ALL).own
        friction = problem.with_entries([], own).friction
        found[name] = 0.5 * (friction.offset_pos_nm + friction.offset_neg_nm)
    assert found["held"] == pytest.approx(LEVEL_NM, rel=0.06)
    assert abs(found["independent"] - LEVEL_NM) > 2.0 * abs(found["held"] - LEVEL_NM)


def test_between_slow_samples_the_balance_is_told_at_fewer_instants() -> None:
    """What slow signals leave is the same on a coarser grid; it counts for as much as they tell."""
    model = rough()
    fast, usual, slow = (recorded(model, every=every) for every in (1, 4, 20))
    assert [one.every for one in (fast, usual, slow)] == [1, 2, 4]
    assert [round(one.independent, 3) for one in (fast, usual, slow)] == [0.64, 0.64, 0.4]
    for one in (fast, usual, slow):
        fine = one.thin(one.balance(model))
        use = sliding(one, model)
        difference = (one.left_over(model) - fine)[use]
        assert np.sqrt(np.mean(difference**2)) <= 0.1 * one.floor_nm(model) * (one.every > 1)
    whole, part = slow.motion(model), slow._motion(model, 4)
    assert np.sum(part.travel_rad) == pytest.approx(np.sum(whole.travel_rad), abs=1e-3)
    np.testing.assert_array_equal(part.time_s, whole.time_s[2::4])
