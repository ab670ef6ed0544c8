"""Noise, filters and rest: what the residual is made of, against closed forms."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.diagnosis.balance.baseline import TIMING
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.noise import noise_of
from eps_hil.diagnosis.data.prepare import Floats, prepare
from eps_hil.identification.butterworth import low_pass
from eps_hil.identification.filters import shifted
from eps_hil.physics.model import Delays, Model, load_model
from eps_hil.series import Series

REFERENCE = Path(__file__).parents[3] / "configs" / "reference_rig.yaml"


@given(st.floats(1e-6, 1e3), st.integers(0, 100))
def test_noise_is_seen_through_motion(sigma: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.arange(8000) * 1e-3
    motion = 50 * sigma * np.sin(7 * t) + 20 * sigma * t**2
    found = noise_of(motion + sigma * rng.standard_normal(len(t)))
    assert found == pytest.approx(sigma, rel=0.08)


def test_noise_of_samples_taken_now_and_then_is_seen_through_motion() -> None:
    rng = np.random.default_rng(8)
    t = np.cumsum(0.03 * (1.0 + 0.5 * rng.uniform(-1.0, 1.0, 4000)))
    noisy = np.sin(1.3 * t) + 1e-4 * rng.standard_normal(len(t))
    assert noise_of(noisy, t) == pytest.approx(1e-4, rel=0.1)
    assert noise_of(noisy) > 3e-4


def test_no_noise_is_no_noise() -> None:
    assert noise_of(np.ones(1000)) == 0.0
    assert noise_of(np.linspace(0, 1, 1000) ** 2) < 1e-8


def test_a_copy_keeps_what_is_remembered_of_its_signals_only(
    record: Callable[..., Any], reference_model: Model
) -> None:
    """Barred samples change no signal; another signal leaves nothing of the old one behind."""
    (series,) = record({}, ("weave",), seconds=5.0).values()
    one = prepare("weave", series)
    before = one.left_over(reference_model)
    barred = one.changed(barred=np.ones(len(one.thin_time_s), dtype=bool))
    np.testing.assert_array_equal(barred.left_over(reference_model), before)
    assert barred.motion(reference_model).speed_rad_s is one.motion(reference_model).speed_rad_s
    halved = {**one.raw, "motor_torque_nm": 0.5 * one.raw["motor_torque_nm"]}
    anew = prepare("weave", {**series, "motor_torque_nm": _half(series["motor_torque_nm"])})
    np.testing.assert_array_equal(
        barred.changed(raw=halved).left_over(reference_model), anew.left_over(reference_model)
    )


def test_recordings_looked_at_together_share_what_may_be_remembered(
    record: Callable[..., Any],
) -> None:
    """A budget for each of a hundred recordings would be a hundred budgets."""
    (series,) = record({}, ("weave",), seconds=5.0).values()
    kept = []
    for among in (1, 10_000):
        one = prepare("weave", series).changed(among=among)
        for late_s in np.linspace(1e-3, 4e-3, 20):
            one._at(one.raw["motor_speed_rad_s"], float(late_s))
        kept.append(len(one._shifted))
    assert kept == [20, 0]


def test_what_is_not_remembered_is_the_same(
    record: Callable[..., Any], reference_model: Model
) -> None:
    """Of an hour nothing is: whoever looks at one recording for long looks at it alone."""
    (series,) = record({}, ("weave",), seconds=5.0).values()
    few = prepare("weave", series)
    many = few.changed(among=10_000)
    alone = many.alone()
    before = few.left_over(reference_model)
    for one in (many, alone):
        np.testing.assert_array_equal(one.left_over(reference_model), before)
    assert not many._shifted
    assert alone._shifted
    assert alone._kinematics is many._kinematics


def test_what_was_wanted_last_is_remembered(record: Callable[..., Any]) -> None:
    """A delay that is tried takes the place of one that was tried before, not of one in use."""
    (series,) = record({}, ("weave",), seconds=5.0).values()
    one = prepare("weave", series).changed(among=400)
    in_use = [one._at(one.raw["motor_speed_rad_s"], 1e-3 * k) for k in range(1, 5)]
    for late_s in np.linspace(5e-3, 9e-3, 20):
        one._at(one.raw["motor_torque_nm"], float(late_s))
        for k, before in enumerate(in_use, 1):
            assert one._at(one.raw["motor_speed_rad_s"], 1e-3 * k) is before


def test_friction_is_worked_out_once_for_what_it_follows_from(
    record: Callable[..., Any], reference_model: Model
) -> None:
    """And anew for all else: the rack's place without its sensor follows from ratio and angle."""
    (series,) = record({}, ("weave",), seconds=5.0).values()
    series = {name: one for name, one in series.items() if name != "rack_position_m"}
    known = prepare("weave", series)
    there = {"effect": "position_dependent_friction", "centre_m": 0.0, "width_m": 0.01}
    local = replace(reference_model, effects=({**there, "level_nm": 0.05},))
    ratio = {"effect": "rack_ratio", "scale": 0.02, "slope_per_m": 0.5, "bend_per_m2": 0.0}
    delays, rubbed = reference_model.delays_s, []
    for model in (
        reference_model,
        replace(reference_model, inertia_kg_m2=2.0 * reference_model.inertia_kg_m2),
        replace(reference_model, delays_s=replace(delays, motor_torque=3e-3)),
        replace(reference_model, effects=({"effect": "motor_torque_offset", "offset_nm": 0.1},)),
        replace(reference_model, delays_s=replace(delays, motor_speed=2e-3)),
        replace(reference_model, friction=replace(reference_model.friction, sigma0_nm_per_rad=9.0)),
        local,
        replace(local, inertia_kg_m2=2.0 * reference_model.inertia_kg_m2),
        replace(local, delays_s=replace(delays, motor_angle=2e-3)),
        replace(local, effects=(*local.effects, ratio)),
        replace(reference_model, effects=({**there, "level_nm": 0.04},)),
    ):
        anew = prepare("weave", series).left_over(model)
        np.testing.assert_array_equal(known.left_over(model), anew)
        rubbed.append(sum(key[0] == "friction" for key in known._shifted))
    assert rubbed == [1, 1, 1, 1, 2, 3, 4, 4, 5, 6, 7]


def test_what_acts_of_a_torque_is_asked_of_the_same_model_once(
    record: Callable[..., Any], reference_model: Model
) -> None:
    (series,) = record({}, ("weave",), seconds=5.0).values()
    known = prepare("weave", series)
    for curvature in (*np.linspace(1e-3, 0.2, 9).tolist(), 1e-3):
        bent = {"effect": "motor_torque_saturation", "curvature_per_nm2": curvature}
        model, again = (replace(reference_model, effects=({**bent},)) for _ in range(2))
        anew = prepare("weave", series).acting_share(model)
        assert known.acting_share(model) == known.acting_share(again) == anew


def _half(one: Series) -> Series:
    return Series(one.t_ns, 0.5 * one.value)


def test_the_floor_is_what_noise_leaves(record: Callable[..., Any], reference_model: Model) -> None:
    """The right model's residual while sliding is the sensor noise, and no more."""
    made = record({}, ("weave", "slow"), seconds=20.0)
    problem = Problem([prepare(name, one) for name, one in made.items()], reference_model)
    residual = problem.residual(reference_model)[problem.sliding]
    assert np.mean(residual**2) == pytest.approx(1.0, abs=0.15)
    assert np.mean(problem.sliding) > 0.4


def test_a_motor_that_saturates_makes_noise_smaller_too(
    record: Callable[..., Any], reference_model: Model
) -> None:
    """Else a model that takes the torque down to next to nothing leaves less than noise."""
    (series,) = record({}, ("weave",), seconds=8.0).values()
    one = prepare("weave", series)
    quiet = {name: 1e-9 for name in one.noise}
    alone = one.changed(noise={**quiet, "motor_torque_nm": one.noise["motor_torque_nm"]})

    def floor(*effects: dict[str, Any]) -> float:
        return alone.floor_nm(replace(reference_model, effects=effects))

    curvature = 1.0
    moving = alone.motion(reference_model).speed_rad_s != 0.0
    squared = curvature * one.raw["motor_torque_nm"][moving] ** 2
    slope = (1.0 - squared) / (1.0 + squared) ** 2
    saturates = {"effect": "motor_torque_saturation", "curvature_per_nm2": curvature}
    smaller = float(np.sqrt(np.mean(slope**2)))
    assert smaller < 0.95
    assert floor(saturates) == pytest.approx(smaller * floor(), rel=0.02)
    gain = {"effect": "motor_torque_gain", "gain": 0.7}
    assert floor(gain) == pytest.approx(0.7 * floor(), rel=1e-6)
    assert floor({"effect": "motor_torque_offset", "offset_nm": 0.3}) == floor()


def test_what_a_diagnosis_needs() -> None:
    t_ns = np.arange(5000, dtype=np.int64) * 1_000_000
    one = Series(t_ns, np.zeros(5000))
    with pytest.raises(ValueError, match="motor_torque_nm"):
        prepare("x", {"motor_speed_rad_s": one})
    with pytest.raises(ValueError, match="motor_angle_rad"):
        prepare("x", {"motor_torque_nm": one})
    short = Series(t_ns[:500], np.zeros(500))
    with pytest.raises(ValueError, match="too short"):
        prepare("x", {"motor_torque_nm": short, "motor_speed_rad_s": short})


def test_a_shift_by_part_of_a_sample_leaves_noise_what_it_is() -> None:
    """Or any delay would make the balance's noise smaller, and be found for that."""
    rng = np.random.default_rng(8)
    t_ns = np.arange(30_000, dtype=np.int64) * 1_000_000
    one = {
        name: Series(t_ns, rng.standard_normal(len(t_ns)))
        for name in ("motor_torque_nm", "motor_speed_rad_s")
    }
    ready = prepare("noise", one)
    speed = ready.raw["motor_speed_rad_s"]

    def left(values: Floats) -> float:
        return float(np.std(low_pass(np.gradient(values, 1e-3), 40.0)[300:-300]))

    for delay_s in (2e-4, 5e-4, -3.4e-3):
        assert left(ready._at(speed, delay_s)) == pytest.approx(left(speed), rel=1e-3)
    straight = np.interp(ready.time_s + 5e-4, ready.time_s, speed)
    assert left(straight) < 0.997 * left(speed)


def test_the_bristle_moves_by_what_the_rotor_did_between_two_samples() -> None:
    """Not by half a sample more: friction turns over in a few milliseconds."""
    t = np.arange(6000) * 1e-3
    t_ns = np.arange(6000) * 1_000_000
    angle, speed = 12.0 * np.sin(2.0 * t), 24.0 * np.cos(2.0 * t)
    columns = {
        "motor_torque_nm": 0.0 * t,
        "motor_speed_rad_s": speed,
        "motor_angle_rad": angle,
    }
    one = prepare("a", {name: Series(t_ns, values) for name, values in columns.items()})
    motion = one.motion(load_model(REFERENCE))
    inside = slice(50, -50)  # signals that are late are held at the ends
    moved = np.cumsum(motion.travel_rad[inside]) - motion.travel_rad[50]
    way = motion.angle_rad[inside] - motion.angle_rad[50]
    assert np.max(np.abs(moved - way)) < 1e-3  # a rest of a sample or two at each reversal
    late = np.cumsum(motion.speed_rad_s[inside]) * 1e-3
    assert np.max(np.abs(late - late[0] - way)) > 0.01


def test_a_path_at_a_part_of_a_sample_has_no_way_back() -> None:
    """Cubics go below zero beside a rest; a bristle of next to no friction has no end there."""
    t_ns = np.arange(6000) * 1_000_000
    speed = np.where(np.arange(6000) // 500 % 2 == 1, 20.0, 0.0)
    columns = {"motor_torque_nm": 0.0 * speed, "motor_speed_rad_s": speed}
    one = prepare("a", {name: Series(t_ns, values) for name, values in columns.items()})
    own = load_model(REFERENCE)
    late = replace(own, delays_s=replace(own.delays_s, motor_speed=0.0024))
    motion = one.motion(late)
    assert np.min(np.abs(motion.travel_rad)) == 0.0
    assert np.min(shifted(np.abs(one._kinematics["travel"]), 0.0024)) < 0.0
    assert np.min(motion.slip_rad) == 0.0


@pytest.mark.parametrize(
    ("form", "rubs"),
    [
        ("free", 0.0),  # nothing but the load cell's noise
        ("light", 60.0),
        ("shaken", 2 / np.pi * 200.0),  # to and fro, too fast for a slow force to show
    ],
)
def test_noise_of_the_load_cell_rubs_nothing(form: str, rubs: float) -> None:
    t = np.arange(20_000) * 1e-3
    t_ns = np.arange(20_000) * 1_000_000
    true = {"free": 0.0 * t, "light": 0.0 * t + 60.0, "shaken": 200.0 * np.sin(200.0 * t)}[form]
    columns = {
        "motor_torque_nm": 0.0 * t,
        "motor_speed_rad_s": 0.0 * t + 10.0,
        "motor_angle_rad": 10.0 * t,
        "rack_force_n": true + np.random.default_rng(3).normal(0.0, 12.0, len(t)),
    }
    one = prepare("a", {name: Series(t_ns, values) for name, values in columns.items()})
    model = load_model(REFERENCE)
    free = replace(model, friction=replace(model.friction, load_pos_nm_per_n=0.0))
    friction = (one.balance(free) - one.balance(model))[1000:-1000]
    expected = model.friction.load_pos_nm_per_n * rubs
    noise = model.friction.load_pos_nm_per_n * 12.0
    assert float(np.mean(friction)) == pytest.approx(expected, abs=0.1 * noise)


def test_values_held_for_rows_now_more_now_fewer_have_noise() -> None:
    """Most third differences are nothing then, and their median too."""
    rng = np.random.default_rng(5)
    rows = np.cumsum(rng.integers(5, 9, 2000))
    held = np.repeat(rng.normal(size=len(rows)), np.diff(rows, append=rows[-1] + 6))
    bends = np.diff(held, n=3)
    assert 0.2 < np.count_nonzero(bends) / len(bends) < 0.5
    assert noise_of(held) > 0.1


def test_without_any_noise_the_right_model_leaves_no_more_than_the_floor(
    reference_model: Model,
) -> None:
    """A torque that is held for 1 ms, on a rotor in 20 steps a sample: what sampling hides."""
    rubs = replace(reference_model.friction, sigma1_nm_s_per_rad=0.0)
    model = replace(reference_model, friction=rubs, delays_s=Delays())
    t_ns = np.arange(6000, dtype=np.int64) * 1_000_000
    torque = 0.4 * np.sin(7.0 * t_ns * 1e-9) + 0.1 * np.sin(23.0 * t_ns * 1e-9)
    speed, angle = np.zeros(len(t_ns)), np.zeros(len(t_ns))
    w = phi = z = 0.0
    for k in range(len(t_ns)):
        speed[k], angle[k] = w, phi
        for _ in range(20):
            forward = w >= 0.0
            level = rubs.offset_pos_nm if forward else rubs.offset_neg_nm
            drag = rubs.viscous_pos_nm_s_per_rad if forward else rubs.viscous_neg_nm_s_per_rad
            level += drag * abs(w)
            z += 5e-5 * (w - rubs.sigma0_nm_per_rad * abs(w) * z / level)
            w += 5e-5 * (torque[k] - rubs.sigma0_nm_per_rad * z) / model.inertia_kg_m2
            phi += 5e-5 * w
    columns = {"motor_torque_nm": torque, "motor_speed_rad_s": speed, "motor_angle_rad": angle}
    columns["rack_force_n"] = np.zeros(len(t_ns))
    one = prepare("silent", {name: Series(t_ns, values) for name, values in columns.items()})
    problem = Problem([one], model)
    free = fit(problem, [], own=TIMING)
    left = float(np.sqrt(np.mean(free.residual[problem.sliding] ** 2)))
    assert 0.05 < left < 1.0


def _slow(step_s: float, sigma: float) -> dict[str, Series]:
    """A joint that swings slowly, its speed in steps and noise that hide it, its angle fine."""
    rng = np.random.default_rng(4)
    t_ns = np.round(np.arange(0.0, 60.0, step_s) * 1e9).astype(np.int64)
    t = t_ns * 1e-9
    speed = 0.06 * np.cos(0.9 * t) + sigma * rng.standard_normal(len(t))
    angle = 0.06 / 0.9 * np.sin(0.9 * t) + 1e-4 * rng.standard_normal(len(t))
    columns = {"motor_torque_nm": np.sin(t), "motor_speed_rad_s": speed, "motor_angle_rad": angle}
    return {name: Series(t_ns, values) for name, values in columns.items()}


@pytest.mark.parametrize("step_s", [1e-3, 1e-2, 4e-2])
def test_noise_of_a_slow_signal_is_none_between_its_samples(step_s: float) -> None:
    one = prepare("joint", _slow(step_s, 5e-3))
    noise = low_pass(one.raw["motor_speed_rad_s"] - 0.06 * np.cos(0.9 * one.time_s), 100.0)
    if one.speed_is_derived:
        assert step_s > 1e-2
    assert one.speed_noise_rad_s == pytest.approx(float(np.std(noise[200:-200])), rel=0.25)


def test_where_noise_hides_the_speed_the_angle_tells_it() -> None:
    hidden = prepare("joint", _slow(4e-2, 2e-2))
    assert hidden.speed_is_hidden
    assert hidden.speed_is_derived
    true = 0.06 * np.cos(0.9 * hidden.time_s)
    assert np.std(hidden.raw["motor_speed_rad_s"] - true) < 5e-3
    assert not prepare("joint", _slow(4e-2, 1e-3)).speed_is_hidden
