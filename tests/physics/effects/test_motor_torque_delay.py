"""A torque that reaches the shaft late: dead time, a first-order lag, or some of both."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.batch import estimate
from eps_hil.physics.balance import Motion, residual_nm
from eps_hil.physics.effects import added
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.effects.effect import Instant
from eps_hil.physics.forward import forward
from eps_hil.physics.model import Model
from eps_hil.series import Series

LAG: Mapping[str, Any] = {"effect": "motor_torque_delay", "delay_s": 5e-3, "lag_share": 1.0}


def lagging(model: Model, **values: float) -> Model:
    return dataclasses.replace(model, effects=({**LAG, **values},))


def test_dead_time_goes_into_the_delays_and_the_lag_stays(reference_model: Model) -> None:
    before = reference_model.delays_s.motor_torque
    worked_in = with_model_effects(lagging(reference_model, lag_share=0.4))
    assert worked_in.delays_s.motor_torque == pytest.approx(before - 3e-3)
    assert worked_in.effects == ({**LAG, "delay_s": 2e-3},)
    again = with_model_effects(worked_in)
    assert again.delays_s == worked_in.delays_s
    assert again.effects == worked_in.effects


@pytest.mark.parametrize("values", [{"lag_share": 0.0}, {"delay_s": -2e-3}])
def test_nothing_lags_behind_a_dead_time_or_what_comes_early(
    reference_model: Model, values: dict[str, float]
) -> None:
    assert with_model_effects(lagging(reference_model, **values)).effects == ()


@pytest.mark.parametrize("step_s", [1e-3, 5e-5])
def test_a_sine_comes_through_as_through_a_low_pass(reference_model: Model, step_s: float) -> None:
    """Amplitude and phase of 1/(1 + jωτ)."""
    table, omega = added.added(lagging(reference_model)), 2 * math.pi * 12.0
    t = np.arange(0.0, 0.5, step_s)
    torque, shaft = 0.7 * np.sin(omega * t), np.empty(len(t))
    for k, (at, reported) in enumerate(zip(t, torque, strict=True)):
        u = Instant(at, 0.0, 0.0, 0.0, 0.0, 0.0, reported, 0.0, 1.0)
        shaft[k] = added.motor_nm(table, u, reported)
        added.advance(table, u, step_s)
    through = 1.0 / complex(1.0, omega * 5e-3)
    expected = 0.7 * abs(through) * np.sin(omega * t + np.angle(through))
    late = t > 0.1
    assert np.max(np.abs(shaft - expected)[late]) < 1e-3 * 0.7


def test_it_begins_settled(reference_model: Model) -> None:
    table = added.added(lagging(reference_model))
    u = Instant(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.0, 1.0)
    for _ in range(20):
        assert added.motor_nm(table, u, 0.4) == pytest.approx(0.4)
        added.advance(table, u, 1e-3)


def test_slow_torques_cannot_tell_it_from_a_dead_time(reference_model: Model) -> None:
    """To first order in ωτ both are the same delay: the balance of a slow torque."""
    n = 4000
    t = np.linspace(0.0, n * 1e-3, n, endpoint=False)
    torque, zero = 0.5 * np.sin(2 * np.pi * 0.3 * t), np.zeros(n)
    late = 0.5 * np.sin(2 * np.pi * 0.3 * (t - 5e-3))
    motion = Motion(t, torque, zero, zero, zero, zero + 20.0, zero, zero + 0.02, zero + 0.02, zero)
    found = residual_nm(lagging(reference_model), motion)[0]
    dead = residual_nm(reference_model, motion._replace(motor_torque_nm=late))[0]
    assert np.max(np.abs(found - dead)[500:]) < 1e-4
    assert np.max(np.abs(found - residual_nm(reference_model, motion)[0])[500:]) > 4e-3


def test_the_estimator_lets_the_torque_lag(reference_model: Model) -> None:
    """The same recording, estimated with the lag, with a dead time of its size, and with none."""
    spring = {"effect": "unmodelled_spring", "stiffness_nm_per_rad": 0.03}
    lag = {**LAG, "delay_s": 12e-3}
    t = np.linspace(0.0, 6.0, 6001)
    t_ns = np.round(t * 1e9).astype(np.int64)
    given = {
        "motor_torque_nm": 0.5 * np.sin(2 * np.pi * t) + 0.4 * np.sin(2 * np.pi * 9.0 * t),
        "rack_force_n": 350.0 * np.sin(2 * np.pi * 0.45 * t),
        "torque_sensor_nm": np.zeros(len(t)),
    }
    series = {name: Series(t_ns, values) for name, values in given.items()}
    found = forward(dataclasses.replace(reference_model, effects=(spring, lag)), series).columns
    inputs = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
    # what the drive reports is what it was asked for, and not what reached the shaft
    recorded = {name: Series(t_ns, found[name]) for name in inputs}

    def off_n(*effects: Mapping[str, Any]) -> float:
        model = dataclasses.replace(reference_model, effects=(spring, *effects))
        trace = estimate(recorded, model)
        good = trace.valid & (trace.t_ns > 500_000_000)
        force = np.interp(trace.t_ns * 1e-9, t, given["rack_force_n"])
        return float(np.sqrt(np.mean((trace.rack_force_n - force)[good] ** 2)))

    lagging_n, late_n = off_n(lag), off_n({**lag, "lag_share": 0.0})
    assert lagging_n < 0.5 * late_n < 0.5 * off_n()
