"""Holes while the load swings: what is only the guess's own error is waited for, not doubted."""

import functools
from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.alignment import RING, push_sample, read_between
from eps_hil.estimation.batch import estimate
from eps_hil.estimation.plausibility import judge_step, limits_of
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.validity import Reason
from eps_hil.estimation.watch import new_watch
from eps_hil.physics.model import Model
from eps_hil.series import Series

NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
AT = 1000
reasons = functools.cache(Reason)
PHASES = np.arange(0.0, 2.0 * np.pi, 0.3)


def told(model: Model, phase: float, holes: str, jump_nm: float = 0.0) -> list[Reason]:
    """What is said of each step of a load that swings at 4 Hz, with ``holes`` from ``AT`` on.

    ``holes``: m for a step without inputs, u for one whose torque is not seen, any other for a
    good one. The torque jumps by ``jump_nm`` with the first.
    """
    t, swing = 1e-3 * np.arange(2400), 2.0 * np.pi * 4.0
    speed = 60.0 * np.sin(swing * t + phase)
    angle = -60.0 / swing * np.cos(swing * t + phase)
    torque = 0.8 * np.sin(swing * t) + jump_nm * (t >= 1e-3 * AT)
    limits, watch, said = limits_of(model, EstimatorSettings(), True), new_watch(), []
    for k in range(len(t)):
        now = holes[k - AT] if 0 <= k - AT < len(holes) else " "
        u = Inputs(torque[k], 0.0, speed[k], angle[k], 0.0, 1e-6, 1e-3, 1e-7)
        missing = int(Reason.BAD_SAMPLE) if now == "m" else 0
        said.append(reasons(judge_step(watch, limits, u, now != "u", missing, True)[0]))
    return said


@pytest.mark.parametrize(
    "holes",
    [
        "m" * 11 + "u" + "m" * 15 + "u" + "m" * 5 + "u",  # never seen in between: one hole
        "m" * 17 + " " * 4 + "m" * 8,  # the second on a course that was itself guessed
        "u" * 17,
        pytest.param("mmm   " * 8, marks=pytest.mark.slow),
    ],
)
def test_a_swing_that_leaves_its_course_in_holes_is_not_doubted(
    reference_model: Model, holes: str
) -> None:
    """It was, for 10 s: no jump back ever showed."""
    for phase in PHASES:
        said = told(reference_model, float(phase), holes)
        assert not any(each & Reason.INCONSISTENT for each in said)
        assert said[AT + len(holes) + 800] == Reason.FINE


@pytest.mark.parametrize(
    "holes", [pytest.param("m" * 7, marks=pytest.mark.slow), "u" * 5, "m" * 3 + "u" * 2]
)
def test_a_jump_in_a_hole_is_told_all_the_same(reference_model: Model, holes: str) -> None:
    for phase in PHASES:
        said = told(reference_model, float(phase), holes, 0.4)
        assert any(each & Reason.INCONSISTENT for each in said[AT : AT + 40])


def test_a_torque_that_is_held_is_not_seen() -> None:
    stamps, values = np.zeros((1, RING), np.int64), np.zeros((1, RING))
    count = np.zeros(1, np.int64)
    for k in range(3):
        push_sample(stamps, values, count, 0, k * 1_000_000, 1.0)
    ages = [read_between(stamps, values, count, 0, t, 20_000_000, 1)[2]
            for t in (1_500_000, 2_000_000, 7_000_000)]  # fmt: skip
    assert ages == [1_000_000, 0, 5_000_000]


def test_torques_that_stop_for_a_moment_are_not_doubted(
    reference_model: Model, weave_truth: Any
) -> None:
    """For 20 ms the last one is held: it says nothing of how the torque goes on."""
    t_ns = np.round(weave_truth.columns["time_s"] * 1e9).astype(np.int64)
    kept = np.ones(len(t_ns), bool)
    for since in range(2000, len(t_ns) - 3000, 1009):
        kept[since : since + 22] = False
    series = {n: Series(t_ns, weave_truth.columns[n]) for n in NAMES}
    for name in NAMES[:2]:
        series[name] = Series(t_ns[kept], series[name].value[kept])
    trace = estimate(series, reference_model)
    assert not np.any(trace.reason & int(Reason.INCONSISTENT))


@pytest.mark.parametrize("share", [1.0, 0.5, 0.24])
def test_a_resting_bristle_keeps_its_torque_where_most_of_the_angle_is_lost(
    reference_model: Model, share: float
) -> None:
    """What is read between few samples has noise that a filter over many steps does not take out.

    Taken for creep it wore the bristle down: 54 mNm in 1.3 s with a quarter of the samples.
    """
    lost_nm = []
    for seed in range(6):
        rng, n = np.random.default_rng(seed), 2500
        t = np.arange(n) * 1e-3
        speed = 10.0 * np.clip((0.8 - t) / 0.3, 0.0, 1.0)
        clean = (np.full(n, 0.3), np.zeros(n), speed, np.cumsum(speed) * 1e-3)
        keep = (t < 1.2) | (rng.random(n) < share)
        keep[-1] = True
        series = {}
        for name, value, noise in zip(NAMES, clean, (2e-3, 2e-3, 0.3, 2e-3), strict=True):
            there = keep if name.startswith(("motor_speed", "motor_angle")) else t >= 0.0
            noisy = value + rng.normal(0.0, noise, n)
            series[name] = Series(1_000_000 * np.flatnonzero(there), noisy[there])
        trace = estimate(series, reference_model)
        before = int(np.searchsorted(trace.t_ns, 1_150_000_000))
        lost_nm.append(trace.friction_torque_nm[before] - trace.friction_torque_nm[-1])
    assert np.mean(lost_nm) < 0.004


@pytest.mark.parametrize("step_s", [1e-3, 2.5e-4, pytest.param(1e-4, marks=pytest.mark.slow)])
def test_a_long_hole_of_the_speed_is_no_jump_at_any_rate(
    reference_model: Model, step_s: float
) -> None:
    """At 10 kHz what lies before a hole of 17 ms and a window is no longer remembered."""
    limits = limits_of(reference_model, EstimatorSettings(step_s=step_s), True)
    steps, lost = round(0.4 / step_s), round(0.017 / step_s)
    swing, t = 2.0 * np.pi * 4.0, step_s * np.arange(steps)
    for phase in PHASES:
        speed = 60.0 * np.sin(swing * t + phase)
        angle = -60.0 / swing * np.cos(swing * t + phase)
        at = steps // 2
        hole = slice(at, at + lost)
        speed[hole] = np.interp(t[hole], t[[at, at + lost]], speed[[at, at + lost]])
        watch = new_watch()
        for k in range(steps):
            periods = float(lost) if at < k < at + lost else 1.0
            u = Inputs(0.0, 0.0, speed[k], angle[k], 0.0, 1e-6, 1e-6, 1e-8, periods)
            said = Reason(judge_step(watch, limits, u, True, 0, True)[0])
            assert not said & Reason.INCONSISTENT


@pytest.mark.parametrize("at", [12_840, 12_965, 13_717, 14_118])
def test_a_resting_bristle_keeps_its_torque_where_frames_are_corrupt(
    reference_model: Model, steps_truth: Any, at: int
) -> None:
    """Of each message 18 % for 0.6 s: an estimate that begins again and again.

    With one noisy speed for the speed that is observed it did not rest for a moment each time, and
    counted the angle's noise as a way: a bristle relaxed that nothing moved.
    """
    t_ns = np.round(steps_truth.columns["time_s"] * 1e9).astype(np.int64)
    part, begins = slice(at - 3000, at + 1200), 3000
    sound, corrupt, random = {}, {}, np.random.default_rng(at)
    bad = {message: random.random(600) < 0.18 for message in ("torque", "motion")}
    for name in NAMES:
        value = steps_truth.columns[name][part].copy()
        sound[name] = Series(t_ns[part], value.copy())
        value[begins : begins + 600][bad["torque" if "torque" in name else "motion"]] = np.nan
        corrupt[name] = Series(t_ns[part], value)
    right, found = estimate(sound, reference_model), estimate(corrupt, reference_model)
    assert np.array_equal(right.t_ns, found.t_ns)
    assert found.valid[-300:].all()
    assert np.abs(found.rack_force_n - right.rack_force_n)[-300:].max() < 60.0


def test_torques_at_half_the_rate_that_was_said_are_a_gap(reference_model: Model) -> None:
    """It was settling for ever, and nothing said why."""
    t_ns = np.arange(4000) * 1_000_000
    speed = 20.0 * np.sin(np.pi * t_ns * 1e-9)
    columns = (0.5 + 0.01 * speed, 0.0 * speed, speed, np.cumsum(speed) * 1e-3)
    names = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
    series = {n: Series(t_ns, v) for n, v in zip(names, columns, strict=True)}
    for name in names[:2]:
        series[name] = Series(t_ns[::2], series[name].value[::2])
    trace = estimate(series, reference_model, periods_s=dict.fromkeys(names, 1e-3))
    assert np.all(trace.reason[-1000:] & int(Reason.GAP))
