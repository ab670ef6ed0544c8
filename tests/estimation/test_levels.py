"""Adapted friction levels in a running estimator: right, without a bump, the same in a replay."""

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.batch import estimate, events, lanes, sample_periods_s
from eps_hil.estimation.levels import FrictionLevels, LevelChange
from eps_hil.estimation.rack_force import RackForceEstimator
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.stream import SIGNALS, Estimate, StreamEstimator, Trace
from eps_hil.physics.model import Model
from eps_hil.series import Series

MS = 1_000_000
NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
SLEW = EstimatorSettings().level_slew_nm_per_s


def wrong(model: Model, factor: float) -> Model:
    f = model.friction
    return replace(
        model,
        friction=replace(
            f, offset_pos_nm=f.offset_pos_nm * factor, offset_neg_nm=f.offset_neg_nm * factor
        ),
    )


def levels_of(model: Model) -> FrictionLevels:
    return FrictionLevels(model.friction.offset_pos_nm, model.friction.offset_neg_nm)


def series_of(truth: Any) -> dict[str, Series]:
    t_ns = np.round(truth.columns["time_s"] * 1e9).astype(np.int64)
    return {name: Series(t_ns, truth.columns[name]) for name in NAMES}


def same(a: Trace, b: Trace) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(Trace))


@pytest.mark.parametrize("speed", [20.0, pytest.param(-20.0, marks=pytest.mark.slow)])
def test_sliding_the_force_goes_over_at_the_set_rate(reference_model: Model, speed: float) -> None:
    """From a wrong level to the right one: 2513 · slew newtons a second, and no faster."""
    right = levels_of(reference_model)
    estimator = RackForceEstimator(wrong(reference_model, 0.6))
    inputs = Inputs(0.02 * speed, 0.0, speed)
    for _ in range(3000):
        before = estimator.step(inputs).rack_force_n
    estimator.set_friction_levels(right)
    forces = np.array([estimator.step(inputs).rack_force_n for _ in range(15_000)])
    fastest = 2513.0 * SLEW * 1e-3
    assert np.abs(np.diff([before, *forces])).max() < 1.05 * fastest
    assert estimator.friction_levels == pytest.approx(right)
    told = RackForceEstimator(reference_model)
    for _ in range(15_000):
        at_once = told.step(inputs).rack_force_n
    assert forces[-1] == pytest.approx(at_once, abs=0.05)
    assert abs(forces[-1] - before) > 30.0


def test_at_rest_nothing_moves(reference_model: Model) -> None:
    estimator = RackForceEstimator(wrong(reference_model, 1.4))
    for k in range(3000):
        before = estimator.step(Inputs(0.5, 0.0, 20.0 if k < 1000 else 0.0)).rack_force_n
    estimator.set_friction_levels(levels_of(reference_model))
    after = [estimator.step(Inputs(0.5, 0.0, 0.0)).rack_force_n for _ in range(20_000)]
    assert np.ptp([before, *after]) < 1e-6


def test_unchanged_levels_change_nothing(reference_model: Model, weave_truth: Any) -> None:
    series = series_of(weave_truth)
    same_levels = [LevelChange(5 * 10**9, *levels_of(reference_model))]
    plain = estimate(series, reference_model)
    assert same(plain, estimate(series, reference_model, changes=same_levels))


def test_a_change_is_replayed_bit_for_bit(reference_model: Model, weave_truth: Any) -> None:
    """Set between two frames while running, then given from the record: the same estimates."""
    series, model = series_of(weave_truth), wrong(reference_model, 0.6)
    periods = sample_periods_s(series)
    live = StreamEstimator(model, EstimatorSettings(), periods)
    kind, t_ns, value = events(series)
    rows: list[Estimate] = []
    changes: list[LevelChange] = []
    for k, (i, t, v) in enumerate(zip(kind, t_ns, value, strict=True)):
        if k in (40_000, 40_001, 90_003):
            share = 0.8 if k < 90_000 else 1.0
            levels = FrictionLevels(*(share * x for x in levels_of(reference_model)))
            later = 700 * MS if k == 40_001 else None
            changes.append(live.set_friction_levels(levels, later and int(t) + later))
        if i >= 0:
            live.push(SIGNALS[i], int(t), float(v))
        else:
            rows += live.estimates(live.advance(int(t)))
    again = StreamEstimator(model, EstimatorSettings(), periods)
    replayed = again.run(lanes(series), changes)
    assert np.array_equal(replayed.rack_force_n, [row.rack_force_n for row in rows])
    assert np.array_equal(replayed.friction_torque_nm, [row.friction_torque_nm for row in rows])
    assert live.friction_levels == pytest.approx(levels_of(reference_model))
    unchanged = estimate(series, model)
    assert not np.array_equal(replayed.rack_force_n[-1000:], unchanged.rack_force_n[-1000:])


def test_levels_survive_what_the_rest_does_not(reference_model: Model) -> None:
    """A jump of time starts the estimator anew; the rig's friction is what it was."""
    stream = StreamEstimator(reference_model, EstimatorSettings(), dict.fromkeys(NAMES[:3], 1e-3))
    levels = FrictionLevels(0.07, 0.1)
    stream.set_friction_levels(levels)
    for start in (0, 100_000):
        for k in range(start, start + 50):
            for name in NAMES[:3]:
                stream.push(name, k * MS, 0.0)
            stream.advance(k * MS)
    assert stream.friction_levels == pytest.approx(levels)


@pytest.mark.parametrize("levels", [(math.nan, 0.1), (0.1, -0.01), (math.inf, 0.1)])
def test_impossible_levels_are_refused(reference_model: Model, levels: tuple[float, float]) -> None:
    estimator = RackForceEstimator(reference_model)
    with pytest.raises(ValueError, match="friction levels"):
        estimator.set_friction_levels(FrictionLevels(*levels))
    assert estimator.friction_levels == levels_of(reference_model)


def test_too_many_changes_at_once_are_refused(reference_model: Model) -> None:
    stream = StreamEstimator(reference_model, EstimatorSettings(), dict.fromkeys(NAMES[:3], 1e-3))
    levels = FrictionLevels(0.1, 0.1)
    for k in range(32):
        stream.set_friction_levels(levels, k * MS)
    with pytest.raises(ValueError, match="wait"):
        stream.set_friction_levels(levels)
