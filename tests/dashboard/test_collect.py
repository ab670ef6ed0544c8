"""Traces at their physical instants: from samples as a monitor hears them, and from columns."""

import math

import numpy as np
import pytest

from eps_hil.dashboard.collect import Collector
from eps_hil.dashboard.recording import blocks_of
from eps_hil.dashboard.traces import CELL, ERROR, ESTIMATE, FRICTION, POSITION, SPEED
from eps_hil.physics.model import Model
from eps_hil.series import Series

MS = 1_000_000
MAPPED = frozenset({"motor_speed_rad_s", "motor_torque_nm", "rack_force_n", "rack_position_m"})


def test_a_signal_stands_where_it_was_and_not_where_it_was_reported(reference_model: Model) -> None:
    collector = Collector(reference_model, MAPPED)
    collector.sample(SPEED, 100 * MS, 3.0)
    collector.sample("motor_torque_nm", 100 * MS, 0.1)
    collector.sample("vehicle_speed_m_s", 100 * MS, 1.0)
    found = collector.drain()
    assert set(found) == {SPEED, "motor_torque_nm", "vehicle_speed_m_s"}
    assert found[SPEED][0].tolist() == [96 * MS]  # reported 4 ms late
    assert found["motor_torque_nm"][0].tolist() == [99 * MS]
    assert collector.drain() == {}


def test_the_residual_compares_one_instant_and_waits_for_the_load_cell(
    reference_model: Model,
) -> None:
    collector = Collector(reference_model, MAPPED)
    for k in range(100):
        collector.sample(CELL, k * MS, 10.0 * k)
        collector.estimate((k + 20) * MS, 20 * MS, 10.0 * k + 7.0, 0.1)
    t_ns, error = collector.drain()[ERROR]
    assert len(t_ns) == 100
    assert error == pytest.approx(7.0)
    collector.estimate(130 * MS, 20 * MS, 1107.0, 0.1)
    assert ERROR not in collector.drain()
    collector.sample(CELL, 120 * MS, 1200.0)
    t_ns, error = collector.drain()[ERROR]
    assert t_ns.tolist() == [110 * MS]
    assert error == pytest.approx(7.0)


def test_an_estimate_that_is_not_valid_is_a_gap(reference_model: Model) -> None:
    collector = Collector(reference_model, MAPPED)
    collector.estimate(100 * MS, 20 * MS, 5.0, 0.1)
    collector.estimate(101 * MS, None, math.nan, math.nan)
    found = collector.drain()
    assert found[ESTIMATE][0].tolist() == [80 * MS, 81 * MS]
    assert np.isnan(found[ESTIMATE][1]).tolist() == [False, True]
    assert np.isnan(found[FRICTION][1]).tolist() == [False, True]


def test_without_a_rack_position_the_rotor_angle_gives_it(reference_model: Model) -> None:
    collector = Collector(reference_model, frozenset({"motor_angle_rad"}))
    collector.sample("motor_angle_rad", 10 * MS, 25.13)
    found = collector.drain()
    assert set(found) == {POSITION, "motor_angle_rad"}
    assert found[POSITION][1] == pytest.approx(0.01)


def test_a_table_gives_the_same_traces(reference_model: Model) -> None:
    t_ns = np.arange(1000, dtype=np.int64) * MS
    series = {
        SPEED: Series(t_ns, np.ones(1000)),
        CELL: Series(t_ns, np.linspace(0.0, 999.0, 1000)),
        ESTIMATE: Series(t_ns, np.linspace(5.0, 1004.0, 1000)),
        "motor_angle_rad": Series(t_ns, np.zeros(1000)),
        "yaw_rate_rad_s": Series(t_ns, np.zeros(1000)),
    }
    found = blocks_of(series, reference_model)
    assert set(found) == {SPEED, CELL, ESTIMATE, ERROR, POSITION}
    assert found[SPEED][0][0] == -4 * MS
    assert found[ERROR][1] == pytest.approx(5.0)
