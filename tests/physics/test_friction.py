"""LuGre friction against closed forms and a second integrator."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from eps_hil.physics.friction import (
    FrictionLaw,
    bristle_step,
    friction_torque_nm,
    static_level_nm,
)

TABLE_2 = FrictionLaw(5.6e-2, 1.258e-1, 4.195e-4, 6.658e-5, 4.993e-5, 4.345e-5, 4.5, 0.075, 0.75)

bristles = st.floats(-0.1, 0.1)
speeds = st.floats(-500, 500)
levels = st.floats(0.01, 1.0)


def test_level_is_equation_3_in_both_directions() -> None:
    assert static_level_nm(10.0, -800.0, TABLE_2) == pytest.approx(
        5.6e-2 + 4.195e-4 * 10 + 4.993e-5 * 800
    )
    assert static_level_nm(-10.0, 800.0, TABLE_2) == pytest.approx(
        1.258e-1 + 6.658e-5 * 10 + 4.345e-5 * 800
    )


def test_level_never_reaches_zero() -> None:
    nothing = TABLE_2._replace(offset_pos_nm=0.0)
    assert static_level_nm(0.0, 0.0, nothing) > 0.0


@given(bristles, speeds, levels, st.floats(1e-6, 0.05))
def test_step_agrees_with_an_ode_solver(z: float, speed: float, level: float, dt: float) -> None:
    def rate(_t: float, y: Any) -> Any:
        return speed - abs(speed) * 4.5 * y / level

    solution = solve_ivp(rate, (0, dt), [z], method="LSODA", rtol=1e-10, atol=1e-13)
    ours = bristle_step(z, speed * dt, abs(speed) * dt, level, 4.5)
    assert ours == pytest.approx(solution.y[0, -1], rel=1e-6, abs=1e-9)


@given(bristles, speeds, levels, st.floats(0, 0.1), st.floats(0, 1))
def test_two_steps_are_one(z: float, speed: float, level: float, dt: float, part: float) -> None:
    first, second = dt * part, dt * (1 - part)
    once = bristle_step(z, speed * dt, abs(speed) * dt, level, 4.5)
    half = bristle_step(z, speed * first, abs(speed) * first, level, 4.5)
    twice = bristle_step(half, speed * second, abs(speed) * second, level, 4.5)
    assert twice == pytest.approx(once, rel=1e-9, abs=1e-12)


@given(bristles, speeds, levels, st.floats(0, 1e6))
def test_step_of_any_length_stays_within_its_limit(
    z: float, speed: float, level: float, dt: float
) -> None:
    after = bristle_step(z, speed * dt, abs(speed) * dt, level, 4.5)
    assert abs(after) <= max(abs(z), level / 4.5) * (1 + 1e-12)


def test_steady_sliding_gives_the_static_level() -> None:
    speed, level = 40.0, 0.2
    z = bristle_step(0.0, speed * 10, speed * 10, level, 4.5)
    assert friction_torque_nm(z, speed, level, TABLE_2) == pytest.approx(level, rel=1e-9)


def test_presliding_is_a_spring() -> None:
    z = bristle_step(0.0, 1e-5, 1e-5, 0.2, 4.5)
    assert z == pytest.approx(1e-5, rel=1e-3)


def test_a_resting_bristle_without_slip_only_follows_the_rotor() -> None:
    assert bristle_step(0.02, 1e-3, 0.0, 0.2, 4.5) == 0.02 + 1e-3


def test_bristle_damping_fades_with_speed() -> None:
    def damping(speed: float) -> float:
        return friction_torque_nm(0.0, speed, 0.2, TABLE_2) / speed

    assert damping(0.01) == pytest.approx(0.075, rel=1e-3)
    assert damping(0.75) == pytest.approx(0.075 / math.e, rel=1e-9)
    assert abs(damping(50.0)) < 1e-12
