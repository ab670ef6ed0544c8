"""The estimator's blocks one by one, on inputs small enough to work out by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.estimation.rack_force import Output, RackForceEstimator
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.validity import Reason
from eps_hil.physics.model import Model, load_model

OFF = EstimatorSettings(friction_compensation=False, dead_zone=False, limiter=False)


def run(estimator: RackForceEstimator, inputs: Inputs, steps: int) -> Output:
    for _ in range(steps):
        out = estimator.step(inputs)
    return out


def test_at_rest_without_compensation_it_is_the_balance_of_torques(reference_model: Model) -> None:
    out = run(RackForceEstimator(reference_model, OFF), Inputs(0.2, 1.0, 0.0), 500)
    assert out.rack_force_n == pytest.approx(2513.0 * (0.2 + 125.7 / 2513.0), rel=1e-6)


def test_sliding_steadily_the_friction_is_taken_off(reference_model: Model) -> None:
    estimator = RackForceEstimator(reference_model)
    out = run(estimator, Inputs(0.5, 0.0, 20.0), 3000)
    # F/i = T − T_fs(ω, F): eq. 3 solved for F
    i, f = 2513.0, reference_model.friction
    level0 = f.offset_pos_nm + f.viscous_pos_nm_s_per_rad * 20
    force = (0.5 - level0) / (1 / i + f.load_pos_nm_per_n)
    assert out.rack_force_n == pytest.approx(force, rel=1e-4)
    assert out.friction_torque_nm == pytest.approx(0.5 - force / i, rel=1e-4)


def test_each_direction_has_its_own_friction(reference_model: Model) -> None:
    forces = [
        run(RackForceEstimator(reference_model), Inputs(sign * 0.5, 0.0, sign * 20.0), 3000)
        for sign in (1, -1)
    ]
    assert forces[0].rack_force_n > -forces[1].rack_force_n > 0


def test_limiter_takes_no_more_than_there_is(reference_model: Model) -> None:
    """Eq. 4a at rest, as far as the friction is unknown: it just began, and hardly slid."""
    estimator = RackForceEstimator(reference_model)
    run(estimator, Inputs(0.3, 0.0, 20.0), 1)
    force_n = run(estimator, Inputs(0.0, 0.0, 0.0), 2000).rack_force_n
    now = estimator.carried.moment[0]
    ratio = reference_model.rack_to_rotor_ratio_rad_per_m
    assert 0.2 * abs(now.unlimited) < now.unknown_nm < abs(now.unlimited)
    assert force_n == pytest.approx(-ratio * (now.unlimited - now.unknown_nm), abs=0.1)


def test_what_is_known_of_the_friction_is_not_taken_off(reference_model: Model) -> None:
    """A rotor that slid, and rests with its bristle bent, holds a rack force without any torque."""
    forces = []
    for limiter in (True, False):
        estimator = RackForceEstimator(reference_model, EstimatorSettings(limiter=limiter))
        run(estimator, Inputs(0.3, 0.0, 20.0), 1000)
        run(estimator, Inputs(0.3, 0.0, 0.0), 20)
        forces.append(run(estimator, Inputs(0.0, 0.0, 0.0), 2000).rack_force_n)
    level_n = reference_model.friction.offset_pos_nm * reference_model.rack_to_rotor_ratio_rad_per_m
    assert forces[0] == pytest.approx(forces[1], abs=0.1)
    assert -2.0 * level_n < forces[0] < -0.8 * level_n


def test_dead_zone_keeps_the_bristle_from_bleeding(reference_model: Model) -> None:
    """DIAGNOSIS: a stuck bristle bleeds under speed noise; the dead zone stops that."""

    def spread(dead_zone: bool) -> float:
        rng = np.random.default_rng(3)
        estimator = RackForceEstimator(
            reference_model, EstimatorSettings(dead_zone=dead_zone, limiter=False)
        )
        held = []
        for k in range(5000):
            speed = (20.0 if k < 1000 else 0.0) + 0.5 * rng.standard_normal()
            held.append(estimator.step(Inputs(0.5, 0.0, speed)).friction_torque_nm)
        return float(np.ptp(held[1100:]))

    assert spread(dead_zone=True) < 0.02
    assert spread(dead_zone=False) > 0.05


def test_low_pass_only_filters(reference_model: Model) -> None:
    steady = [
        run(
            RackForceEstimator(reference_model, EstimatorSettings(low_pass=on)),
            Inputs(0.4, 0.0, 10.0),
            3000,
        ).rack_force_n
        for on in (True, False)
    ]
    assert steady[0] == pytest.approx(steady[1], rel=1e-6)
    lag = [
        RackForceEstimator(reference_model, EstimatorSettings(low_pass=on)).lag_s
        for on in (True, False)
    ]
    assert lag[0] > lag[1]


def test_known_rack_force_gives_the_friction(reference_model: Model) -> None:
    estimator = RackForceEstimator(reference_model, EstimatorSettings(quantity="friction"))
    for k in range(2000):  # constant speed: what is left of the torque is friction
        out = estimator.step(Inputs(0.4, 0.0, 20.0, 0.02 * k, 500.0))
    assert out.friction_torque_nm == pytest.approx(0.4 - 500.0 / 2513.0, rel=1e-6)
    assert math.isnan(out.rack_force_n), "it is given, not estimated"


def test_bad_inputs_hold_the_estimate_and_it_settles_again(reference_model: Model) -> None:
    estimator = RackForceEstimator(reference_model)
    good = Inputs(0.5, 0.0, 20.0)
    before = run(estimator, good, 500)
    assert before.reason == Reason.FINE
    bad = estimator.step(good._replace(motor_speed_rad_s=math.nan))
    assert bad.reason == Reason.BAD_SAMPLE
    assert bad.rack_force_n == before.rack_force_n
    assert estimator.step(good).reason == Reason.SETTLING | Reason.FRICTION_UNKNOWN
    assert run(estimator, good, 150).reason == Reason.FINE


def test_reset_forgets(reference_model: Model) -> None:
    one, other = RackForceEstimator(reference_model), RackForceEstimator(reference_model)
    run(one, Inputs(0.5, 0.2, 20.0), 300)
    one.reset()
    assert run(one, Inputs(0.1, 0.0, 1.0), 50) == run(other, Inputs(0.1, 0.0, 1.0), 50)


@settings(max_examples=30)
@given(
    st.lists(
        st.tuples(
            st.floats(-10, 10) | st.just(math.nan),
            st.floats(-100, 100) | st.just(math.inf),
            st.floats(-2000, 2000),
        ),
        min_size=1,
        max_size=200,
    )
)
def test_whatever_comes_the_output_is_finite(rows: list[tuple[float, float, float]]) -> None:
    from pathlib import Path

    model = load_model(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")
    estimator = RackForceEstimator(model)
    for row in rows:
        out = estimator.step(Inputs(*row))
        assert math.isfinite(out.rack_force_n)
        assert math.isfinite(out.friction_torque_nm)
