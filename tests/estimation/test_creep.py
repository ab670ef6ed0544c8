"""The way of a rotor while its estimate is held: it bends the bristle, noise and jumps do not."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.estimation.batch import estimate
from eps_hil.estimation.creep import carry, follow_creep, slide_on
from eps_hil.estimation.plausibility import limits_of
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Inputs, constants, physics_of
from eps_hil.estimation.state import HELD, new_carried
from eps_hil.estimation.stream import Trace
from eps_hil.estimation.watch import CREPT_RING, new_watch
from eps_hil.physics.friction import bristle_step, static_level_nm
from eps_hil.physics.model import Model
from eps_hil.series import Series

NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
BENT = 0.0124
NOISE_RAD = 1e-3


def out_and_back(
    way_rad: float, back_rad: float | None = None, out_s: float = 0.04, back_s: float = 0.06
) -> dict[str, Series]:
    """Half a second of sine, rest, at 1.06 s a creep on, then one back (as far, if not said)."""
    back_rad = way_rad if back_rad is None else back_rad
    t, turns = np.arange(3500) * 1e-3, 1.06 + out_s
    speed = np.where(t < 0.5, 20.0 * np.sin(2 * np.pi * t), 0.0)
    speed += np.where((t >= 1.06) & (t < turns), way_rad / out_s, 0.0)
    speed -= np.where((t >= turns) & (t < turns + back_s), back_rad / back_s, 0.0)
    t_ns = (t * 1e9).round().astype(np.int64)
    torque = np.where(t < 0.5, 0.5 + 0.01 * speed, 0.5)
    noise = np.random.default_rng(2).standard_normal((4, len(t)))
    columns = (
        torque + 1e-3 * noise[0],
        1e-3 * noise[1],
        speed + 0.1 * noise[2],
        np.cumsum(speed) * 1e-3 + NOISE_RAD * noise[3],
    )
    return {name: Series(t_ns, value) for name, value in zip(NAMES, columns, strict=True)}


def at(trace: Trace, time_s: float) -> float:
    return float(trace.rack_force_n[np.searchsorted(trace.t_ns, time_s * 1e9)])


@pytest.mark.parametrize("since_ms", [1112, 1118, 1124])
def test_a_quick_way_back_is_not_smoothed_away(reference_model: Model, since_ms: int) -> None:
    """An angle that jumps just after a rotor swung back by 0.013 rad of 0.06: 107 N were off."""
    series = out_and_back(0.06, 0.0134, 0.03, 0.015)
    right = estimate(series, reference_model)
    angle = series[NAMES[3]].value.copy()
    angle[since_ms : since_ms + 240] += 0.0825
    series[NAMES[3]] = Series(series[NAMES[3]].t_ns, angle)
    assert abs(at(estimate(series, reference_model), 3.0) - at(right, 3.0)) < 60.0


@pytest.mark.parametrize(
    ("name", "off"), [(NAMES[2], 2.1), (NAMES[2], -2.1), (NAMES[0], 0.3), (NAMES[3], 0.2)]
)
def test_what_is_held_is_bent_by_a_way_out_and_back(
    reference_model: Model, name: str, off: float
) -> None:
    """The contact slides on the way out, and bends on the way back, to the same angle.

    Smoothing and noise hold back some milliradians: 11 N each, of 100 N that count as wrong.
    """
    series = out_and_back(0.015)
    right = estimate(series, reference_model)
    assert at(right, 3.0) - at(right, 1.0) > 100.0
    series[name].value[1040:1340] += off
    trace = estimate(series, reference_model)
    assert not np.any(trace.valid[(trace.t_ns > 1.1e9) & (trace.t_ns < 1.3e9)])
    assert np.all(trace.valid[trace.t_ns > 3.0e9])
    assert at(trace, 3.4) == pytest.approx(at(right, 3.4), abs=50.0)


@pytest.mark.parametrize("lost_s", [(1.03, 1.24), (1.03, 1.6), (1.055, 1.2)])
def test_a_hole_of_the_torques_is_bent_by_a_way_out_and_back(
    reference_model: Model, lost_s: tuple[float, float]
) -> None:
    """The angle is seen all the while; taken to be where it was, the bristle was 100 N off."""
    series = out_and_back(0.015)
    right = estimate(series, reference_model)
    assert at(right, 3.0) - at(right, 1.0) > 100.0
    for name in NAMES[:2]:
        t_ns, value = series[name].t_ns, series[name].value
        seen = (t_ns < lost_s[0] * 1e9) | (t_ns > lost_s[1] * 1e9)
        series[name] = Series(t_ns[seen], value[seen])
    trace = estimate(series, reference_model)
    hole = (trace.t_ns > lost_s[0] * 1e9 + 30e6) & (trace.t_ns < lost_s[1] * 1e9 - 30e6)
    assert not np.any(trace.valid[hole])
    assert np.all(trace.valid[trace.t_ns > 3.0e9])
    assert at(trace, 3.4) == pytest.approx(at(right, 3.4), abs=50.0)


def test_moments_without_the_angle_lose_no_way(reference_model: Model) -> None:
    """Of 3 ms each, in a hole of the torques over which a rotor went out and back."""
    series = out_and_back(0.015)
    right = estimate(series, reference_model)
    for name in NAMES:
        t_ns, value = series[name].t_ns, series[name].value
        if name in NAMES[:2]:
            seen = (t_ns < 1.03e9) | (t_ns > 1.6e9)
            series[name] = Series(t_ns[seen], value[seen])
            continue
        for since in (1040, 1092, 1130, 1300):
            value[since : since + 3] = np.nan
    trace = estimate(series, reference_model)
    assert np.all(trace.valid[trace.t_ns > 3.0e9])
    assert at(trace, 3.4) == pytest.approx(at(right, 3.4), abs=50.0)


def test_what_turned_back_in_a_hole_is_not_forgotten_with_a_doubt_after_it(
    reference_model: Model,
) -> None:
    """The state from before the doubt is from before the hole: there and now the angle is one."""
    series = out_and_back(0.015, out_s=0.02, back_s=0.025)
    right = estimate(series, reference_model)
    for name in NAMES:
        t_ns, value = series[name].t_ns, series[name].value
        if name == NAMES[2]:
            value[1250:1290] -= 14.3
        seen = (t_ns < 1.08e9) | (t_ns > 1.12e9)
        series[name] = Series(t_ns[seen], value[seen])
    trace = estimate(series, reference_model)
    same = np.searchsorted(right.t_ns, trace.t_ns)
    wrong = np.abs(trace.rack_force_n - right.rack_force_n[same]) > 100.0
    assert np.any(trace.reason[trace.t_ns > 1.26e9] != 0)
    assert not np.any(wrong & trace.valid & right.valid[same])


def test_an_offset_that_hides_the_rotors_own_way_is_no_rest(reference_model: Model) -> None:
    """The angle is where it was, the rotor is not: seen by the jump that the way cannot explain."""
    series = out_and_back(0.0)
    t = np.arange(3500) * 1e-3
    slowing = np.where((t >= 1.0) & (t < 1.04), -4.5 * (1.04 - t) / 0.04, 0.0)
    series[NAMES[2]].value[:] += slowing
    series[NAMES[3]].value[:] += np.cumsum(slowing) * 1e-3
    right = estimate(series, reference_model)
    series[NAMES[3]].value[1020:1400] += 0.09
    trace = estimate(series, reference_model)
    wrong = np.abs(trace.rack_force_n - right.rack_force_n) > 100.0
    assert np.sum(wrong & trace.valid & right.valid) <= 20


def walked(model: Model, path: Any, bristle: float, jumps: Any) -> tuple[float, float, float]:
    """Bristle that is carried along ``path`` (n,) rad, that of the path itself, change of zero."""
    rng, watch, carried = np.random.default_rng(3), new_watch(), new_carried()
    w, s = watch[0], carried.moment[0]
    limits, physics = limits_of(model, EstimatorSettings(), True), physics_of(model)
    c, before, exact = constants(model, EstimatorSettings()), 0.0, bristle
    s.running, s.carried, s.bent = HELD, 1, bristle
    measured = path + jumps + NOISE_RAD * rng.standard_normal(len(path))
    for k in range(-200, len(path)):
        angle = float(measured[k]) if k >= 0 else NOISE_RAD * float(rng.standard_normal())
        u = Inputs(0.0, 0.0, 0.0, angle, 0.0, 1e-6, 1e-3, NOISE_RAD**2)
        w.angle = before
        follow_creep(w, limits, u)
        before = angle
        if k < 0:
            s.zero = w.zero
            continue
        carry(w, c, physics, s, carried.rig[0], 1)
        went = float(path[k] - (path[k - 1] if k else 0.0))
        level = static_level_nm(1e-9 * went, 0.0, physics.law)
        level += sum(one["level_nm"] for one in model.effects)
        exact = bristle_step(exact, went, abs(went), level, physics.law.sigma0_nm_per_rad)
    return float(s.bent), float(exact), float(s.other_zero)


@settings(max_examples=20, deadline=None)
@given(
    turn=st.floats(-0.03, 0.03),
    jump=st.sampled_from([0.0, 0.08, -1.0]),
    bristle=st.floats(-BENT, BENT),
)
def test_the_way_without_jumps_and_noise_bends_the_bristle(
    reference_model: Model, turn: float, jump: float, bristle: float
) -> None:
    """As eq. 2a does along the true path, but for what smoothing and noise hold back."""
    k = np.arange(650)  # at rest at the end: what is followed is some ms behind
    path = np.interp(k, [0, 100, 250, 500, 600], [0.0, 0.0, turn, -0.5 * turn, 0.0])
    jumps = np.where(k > 60, jump, 0.0)
    bent, exact, other_zero = walked(reference_model, path, bristle, jumps)
    assert bent == pytest.approx(exact, abs=0.002)
    assert other_zero == pytest.approx(jump, abs=0.002)


@pytest.mark.parametrize("half", [-0.009, 0.009])
def test_a_jump_that_is_read_half_way_first_is_no_way(reference_model: Model, half: float) -> None:
    """A sample within the noise of a jump to come was taken for a way out, and its end for back."""
    jumps = np.zeros(600)
    jumps[100:300] = 48.0 * half
    jumps[99] = jumps[300] = half
    bent, exact, _ = walked(reference_model, np.zeros(600), -math.copysign(BENT, half), jumps)
    assert bent == pytest.approx(exact, abs=0.0005)


def test_a_way_with_lost_steps_carries_nothing(reference_model: Model) -> None:
    """Nor one that is longer than what is remembered."""
    watch, carried, physics = new_watch(), new_carried(), physics_of(reference_model)
    w, s, c = watch[0], carried.moment[0], constants(reference_model, EstimatorSettings())
    for unbroken, steps, known in ((5, 4, 1), (5, 5, 0), (5000, CREPT_RING, 0)):
        w.unbroken, s.running, s.carried = unbroken, HELD, 1
        carry(w, c, physics, s, carried.rig[0], steps)
        assert s.carried == known


STRIBECK = ({"effect": "stribeck", "level_nm": 0.3, "speed_rad_s": 2.0},)


def test_creep_bends_the_bristle_by_the_level_with_its_effects(reference_model: Model) -> None:
    model = replace(reference_model, effects=STRIBECK)
    path = np.interp(np.arange(650), [0, 100, 500], [0.0, 0.0, 0.06])
    bent, exact, _ = walked(model, path, 0.0, np.zeros(650))
    assert exact > 1.5 * BENT
    assert bent == pytest.approx(exact, abs=0.002)


def test_a_slide_without_an_estimate_has_the_friction_with_its_effects(
    reference_model: Model,
) -> None:
    u, found = Inputs(0.0, 0.0, 0.1, 0.0), []
    for model in (reference_model, replace(reference_model, effects=STRIBECK)):
        watch, carried = new_watch(), new_carried()
        c, physics = constants(model, EstimatorSettings()), physics_of(model)
        for _ in range(5000):
            slide_on(watch, c, physics, carried.moment[0], carried.rig[0], u)
        found.append(float(watch[0].friction_nm))
    assert found[1] - found[0] == pytest.approx(0.3, abs=0.01)
