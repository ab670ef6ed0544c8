"""What effects remember goes on where nothing is estimated (memory.py)."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.batch import estimate
from eps_hil.estimation.rack_force import RackForceEstimator
from eps_hil.estimation.settings import EstimatorSettings, PlausibilitySettings
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.stream import Trace
from eps_hil.estimation.validity import Reason
from eps_hil.physics.model import Model
from eps_hil.series import Series

NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
UNKNOWN = int(Reason.FRICTION_UNKNOWN)
LONG_NS = 1_200_000_000


def heated(model: Model, time_s: float) -> Model:
    """A motor whose torque falls by 3 % for each Nm² of its squared torque, remembered."""
    law = {
        "effect": "empirical",
        "form": "law",
        "where": "motor",
        "how": "factor",
        "inputs": ["motor_torque_nm"],
        "memory": ["heat"],
        "shapes": ["linear"],
        "memory_1": time_s,
        "size": -0.03,
    }
    return replace(model, effects=(law,))


def loaded(seconds: int) -> dict[str, Series]:
    t = np.arange(seconds * 1000) * 1e-3
    rng = np.random.default_rng(1)
    speed = 20.0 * np.sin(0.4 * np.pi * t)
    columns = (
        2.2 + 0.1 * np.sin(0.4 * np.pi * t) + 2e-4 * rng.standard_normal(len(t)),
        0.002 * rng.standard_normal(len(t)),
        speed + 0.02 * rng.standard_normal(len(t)),
        np.cumsum(speed) * 1e-3 + 1e-4 * rng.standard_normal(len(t)),
    )
    t_ns = (t * 1e9).round().astype(np.int64)
    return {name: Series(t_ns, value) for name, value in zip(NAMES, columns, strict=True)}


def silent(series: dict[str, Series], since_ns: int) -> dict[str, Series]:
    found = {}
    for name, one in series.items():
        seen = (one.t_ns < since_ns) | (one.t_ns >= since_ns + LONG_NS)
        found[name] = Series(one.t_ns[seen], one.value[seen])
    return found


def after(trace: Trace, since_s: float, until_s: float) -> Any:
    return (trace.t_ns > since_s * 1e9) & (trace.t_ns < until_s * 1e9)


@pytest.mark.parametrize("kind", ["observer", "bristle_filter"])
def test_a_silent_bus_cools_no_motor(reference_model: Model, kind: Any) -> None:
    """What it remembered was zero after it: a warm motor was 570 N off and valid."""
    model, settings = heated(reference_model, 2.0), EstimatorSettings(kind=kind)
    whole = loaded(26)
    right = estimate(whole, model, settings)
    trace = estimate(silent(whole, 14_000_000_000), model, settings)
    _, ours, theirs = np.intersect1d(trace.t_ns, right.t_ns, return_indices=True)
    both = trace.valid[ours] & right.valid[theirs] & (trace.t_ns[ours] > 15_500_000_000)
    assert np.count_nonzero(both) > 4000
    error = trace.rack_force_n[ours][both] - right.rack_force_n[theirs][both]
    assert np.max(np.abs(error)) < 30.0
    unknown = (trace.reason & UNKNOWN) != 0
    assert np.all(unknown[after(trace, 15.6, 16.6)])  # it may have cooled by 380 N
    assert not np.any(unknown[after(trace, 21.5, 25.0)])


def test_a_silence_that_is_short_for_the_memory_leaves_nothing_unknown(
    reference_model: Model,
) -> None:
    trace = estimate(silent(loaded(18), 14_000_000_000), heated(reference_model, 60.0))
    assert np.all(trace.reason[after(trace, 16.5, 17.9)] == 0)


def test_held_steps_move_the_memory_on(reference_model: Model) -> None:
    """By the last inputs; it stood still, and was behind by as much as was held."""
    found = []
    for held in (Reason.FINE, Reason.MOTOR_TORQUE):
        estimator = RackForceEstimator(heated(reference_model, 6.0))
        for k in range(4000):
            estimator.step(Inputs(2.2, 0.0, 20.0), held if k >= 1000 else Reason.FINE)
        found.append(estimator.physics.effects.state.copy())
    assert float(found[0].max()) > 2.0
    assert found[1] == pytest.approx(found[0])


def test_nonsense_forgets_what_it_spoilt(reference_model: Model) -> None:
    estimator = RackForceEstimator(heated(reference_model, 6.0))
    for _ in range(300):
        estimator.step(Inputs(2.2, 0.0, 20.0))
    assert estimator.step(Inputs(1e9, 0.0, 20.0)).reason & Reason.DIVERGED
    assert not np.any(estimator.physics.effects.state)


@pytest.mark.parametrize("kind", ["observer", "bristle_filter", "smoother"])
def test_a_start_may_be_of_a_warm_motor(reference_model: Model, kind: Any) -> None:
    """It was taken as cold: hundreds of newtons off, and valid, after a service began again."""
    model, series = heated(reference_model, 2.0), loaded(26)
    cold = estimate(series, model, EstimatorSettings(kind=kind))
    trace = estimate(series, model, EstimatorSettings(kind=kind, memory_at_start="unknown"))
    unknown = (trace.reason & UNKNOWN) != 0
    assert np.all(unknown[after(trace, 0.0, 8.0)])
    assert not np.any(unknown[after(trace, 22.0, 25.0)])  # eleven times the memory
    assert np.array_equal(trace.rack_force_n, cold.rack_force_n)
    assert np.mean((cold.reason & UNKNOWN)[after(cold, 0.0, 8.0)] != 0) < 0.1


def test_a_speed_is_remembered_over_a_silence_as_a_torque_is(reference_model: Model) -> None:
    law = {
        "effect": "empirical",
        "form": "law",
        "where": "motor",
        "how": "factor",
        "inputs": ["motor_speed_rad_s"],
        "memory": ["heat"],
        "shapes": ["linear"],
        "memory_1": 2.0,
        "size": -5e-4,
    }
    trace = estimate(silent(loaded(26), 14_000_000_000), replace(reference_model, effects=(law,)))
    unknown = (trace.reason & UNKNOWN) != 0
    assert np.any(unknown[after(trace, 15.6, 16.6)])


def test_after_nonsense_what_a_warm_motor_remembers_is_unknown(reference_model: Model) -> None:
    """It was nothing, and valid."""
    series = loaded(12)
    torque = series["motor_torque_nm"]
    torque.value[6000:6003] = 1e9
    settings = EstimatorSettings(plausibility=PlausibilitySettings(enabled=False))
    trace = estimate(series, heated(reference_model, 2.0), settings)
    assert np.any(trace.reason & int(Reason.DIVERGED))
    unknown = (trace.reason & UNKNOWN) != 0
    assert np.all(unknown[after(trace, 7.0, 10.0)])
