"""Torque from supply power: exact where power tells, the assist law where it does not."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.bus.supply_power import SupplyPower, SupplyPowerTorque

MS = 1_000_000


def law(**changes: float) -> SupplyPower:
    numbers = {
        "assist_gain": 0.4,
        "blend_speed_rad_s": 40.0,
        "efficiency": 0.8,
        "standby_w": 10.0,
        "lag_s": 0.028,
    }
    return SupplyPower("M", "I", "U", **(numbers | changes))


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_fast_motion_gives_power_over_speed(direction: float) -> None:
    torque = law().torque_nm(10.0 + 1.2 * 1e4 / 0.8, direction * 1e4, 0.0)
    assert torque == pytest.approx(direction * 1.2, rel=1e-3)


def test_standstill_gives_assist_whatever_the_losses() -> None:
    assert law().torque_nm(80.0, 0.0, 3.0) == pytest.approx(1.2)


def test_braking_returns_power_after_losses() -> None:
    fast = law(blend_speed_rad_s=1e-3)
    assert fast.torque_nm(10.0 - 80.0, 100.0, 0.0) == pytest.approx(-1.0)


@given(
    torque=st.floats(-3, 3),
    speed=st.floats(-300, 300),
)
def test_true_torque_and_true_assist_are_left_alone(torque: float, speed: float) -> None:
    """Where assist law and power agree, the joined value is theirs at every speed."""
    gain = 0.4
    bar = torque / gain
    shaft = torque * speed
    drawn = 10.0 + (shaft / 0.8 if shaft > 0 else shaft * 0.8)
    assert law(assist_gain=gain).torque_nm(drawn, speed, bar) == pytest.approx(torque, abs=1e-9)


def turning(speed_rad_s: float, bar_nm: float) -> SupplyPowerTorque:
    """A decoder that has seen 200 ms of steady turning, angle each 10 ms, bar torque each 20."""
    torque = SupplyPowerTorque(law())
    for t in range(0, 201, 10):
        torque.see_angle(t * MS, speed_rad_s * t * 1e-3)
    for t in range(0, 201, 20):
        torque.see_sensor(t * MS, bar_nm)
    return torque


def test_speed_comes_from_the_angle_at_the_lagged_instant() -> None:
    got = turning(120.0, 3.0).torque_nm(200 * MS, 20.0, 14.0)
    assert got == pytest.approx(law().torque_nm(280.0, 120.0, 3.0))


def test_power_is_paired_with_the_speed_of_its_own_instant() -> None:
    """Under acceleration the speed of 28 ms ago is not the speed of now."""
    torque = SupplyPowerTorque(law())
    for t in range(0, 201, 10):
        torque.see_angle(t * MS, 0.5 * 1000.0 * (t * 1e-3) ** 2)
        torque.see_sensor(t * MS, 0.0)
    got = torque.torque_nm(200 * MS, 20.0, 14.0)
    assert got == pytest.approx(law().torque_nm(280.0, 172.0, 0.0), rel=0.01)


def test_nothing_is_said_before_the_lag_is_filled() -> None:
    torque = SupplyPowerTorque(law())
    torque.see_angle(0, 0.0)
    torque.see_sensor(0, 1.0)
    assert torque.torque_nm(0, 1.0, 14.0) is None


def test_bad_angle_makes_a_bad_torque() -> None:
    torque = turning(10.0, 1.0)
    torque.see_angle(190 * MS, math.nan)  # a step back in time begins anew as well
    assert torque.torque_nm(200 * MS, 1.0, 14.0) is None
    torque = turning(10.0, 1.0)
    torque.see_sensor(210 * MS, math.nan)
    torque.see_angle(240 * MS, 0.0)
    got = torque.torque_nm(228 * MS, 1.0, 14.0)
    assert got is not None
    assert math.isfinite(got)
    torque.see_sensor(240 * MS, 1.0)
    got = torque.torque_nm(248 * MS, 1.0, 14.0)
    assert got is not None
    assert math.isnan(got)
