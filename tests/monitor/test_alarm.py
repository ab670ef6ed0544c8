"""Alarms: a limit, a time, hysteresis, and no opinion where there is no figure."""

from dataclasses import replace

import pytest

from eps_hil.monitor.alarm import Alarm, Alarms, Limits, friction_at_rack_n, limits_of
from eps_hil.physics.model import Model

S = 1_000_000_000


def fed(alarm: Alarm, *figures: float | None) -> list[tuple[int, bool]]:
    """(second, on) of each change; one figure a second."""
    return [(k, alarm.on) for k, rms in enumerate(figures) if alarm.update(k * S, rms)]


def test_it_takes_the_whole_time_beyond_the_limit() -> None:
    assert fed(Alarm(50.0, 3.0), 60, 60, 60, 60) == [(3, True)]
    assert fed(Alarm(50.0, 3.0), 60, 60, 60) == []


def test_one_good_figure_starts_the_time_anew() -> None:
    assert fed(Alarm(50.0, 3.0), 60, 60, 49, 60, 60, 60) == []


def test_it_ends_below_seven_tenths_for_as_long() -> None:
    raised = (60, 60, 60, 60)
    assert fed(Alarm(50.0, 3.0), *raised, 40, 40, 40, 40, 40) == [(3, True)]
    assert fed(Alarm(50.0, 3.0), *raised, 30, 30, 30, 30) == [(3, True), (7, False)]
    assert fed(Alarm(50.0, 3.0), *raised, 30, 30, 40, 30, 30, 30) == [(3, True)]


def test_without_a_figure_it_stays_and_the_time_does_not_count() -> None:
    assert fed(Alarm(50.0, 3.0), 60, 60, None, 60, 60) == []
    assert fed(Alarm(50.0, 3.0), 60, 60, float("nan"), 60, 60) == []
    alarm = Alarm(50.0, 0.0)
    assert fed(alarm, 60, None, None) == [(0, True)]
    assert alarm.on


def test_a_clock_that_is_set_back_does_not_raise_it_early_or_never() -> None:
    alarm = Alarm(50.0, 3.0)
    alarm.update(100 * S, 60.0)
    assert not alarm.update(10 * S, 60.0)
    assert alarm.update(13 * S, 60.0)


def test_limits_are_shares_of_the_models_friction(reference_model: Model) -> None:
    friction = 0.5 * (5.6e-2 + 1.258e-1) * 2513.0
    assert friction_at_rack_n(reference_model) == pytest.approx(friction)
    limits = limits_of(reference_model)
    assert limits.moving_n == pytest.approx(0.35 * friction)
    assert limits.resting_n == pytest.approx(friction)
    assert limits.balance_n == pytest.approx(0.2 * friction)
    given = limits_of(reference_model, 10.0, 20.0, 30.0, after_s=1.0)
    assert given == Limits(10.0, 20.0, 30.0, 1.0)
    assert [given.of(name) for name in ("moving", "at rest", "torque balance")] == [10, 20, 30]


def test_a_rig_with_little_friction_keeps_a_limit_that_an_estimate_can_meet(
    reference_model: Model,
) -> None:
    friction = replace(reference_model.friction, offset_pos_nm=1e-4, offset_neg_nm=1e-4)
    smooth = replace(reference_model, friction=friction)
    assert limits_of(smooth) == Limits(25.0, 25.0, 25.0)


def test_friction_that_an_effect_scales_counts(reference_model: Model) -> None:
    more = replace(reference_model, effects=({"effect": "coulomb_level", "scale": 1.5},))
    assert friction_at_rack_n(more) == pytest.approx(1.5 * friction_at_rack_n(reference_model))


def test_several_residuals_alarm_on_their_own() -> None:
    alarms = Alarms(Limits(50.0, 100.0, 20.0, 2.0))
    seen = [
        alarms.update(k * S, {"moving": 60.0, "at rest": 60.0, "torque balance": None})
        for k in range(3)
    ]
    assert seen == [[], [], [("moving", True)]]
    assert alarms.on == ("moving",)
    alarms.update(3 * S, {"moving": 60.0, "at rest": 200.0})
    assert alarms.pending == ("at rest",)
