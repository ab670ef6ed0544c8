"""A ratio that varies over the rack: φ = i·x·(1 + scale + slope·x + bend·x²)."""

import dataclasses
from typing import Literal, get_args

import numpy as np
import pytest

from eps_hil.estimation.batch import estimate
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.physics.balance import Motion, residual_nm
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.forward import forward
from eps_hil.physics.model import Friction, Model
from eps_hil.physics.simulate import rack_position_m
from eps_hil.series import Series

SCALE, SLOPE, BEND = 0.03, 2.0, 30.0
ENTRY = {"effect": "rack_ratio", "scale": SCALE, "slope_per_m": SLOPE, "bend_per_m2": BEND}
T = np.linspace(0.0, 6.0, 6001)
T_NS = np.round(T * 1e9).astype(np.int64)


def varying(model: Model, **friction: float) -> Model:
    """The rig with that ratio, on a spring (so that it stays in the middle)."""
    spring = {"effect": "unmodelled_spring", "stiffness_nm_per_rad": 0.03}
    own = Friction(**{**dataclasses.asdict(model.friction), **friction})
    return dataclasses.replace(model, friction=own, effects=(spring, ENTRY))


def driven() -> dict[str, Series]:
    """Motor, hand and load, all at once, wide enough for the ratio to change by a tenth."""
    columns = {
        "motor_torque_nm": 0.9 * np.sin(2 * np.pi * 0.8 * T) + 0.3 * np.sin(2 * np.pi * 2.1 * T),
        "torque_sensor_nm": 2.0 * np.sin(2 * np.pi * 0.6 * T + 1.0),
        "rack_force_n": 500.0 * np.sin(2 * np.pi * 0.45 * T),
    }
    return {name: Series(T_NS, column) for name, column in columns.items()}


def test_rack_and_rotor_stand_where_the_ratio_puts_them(reference_model: Model) -> None:
    x = np.linspace(-0.03, 0.03, 301)
    i = reference_model.rack_to_rotor_ratio_rad_per_m
    turned = i * x * (1.0 + SCALE + SLOPE * x + BEND * x**2)
    model = dataclasses.replace(reference_model, effects=(ENTRY,))
    np.testing.assert_allclose(rack_position_m(model, turned), x, atol=1e-9)
    np.testing.assert_array_equal(rack_position_m(reference_model, turned), turned / i)


def test_worked_in_twice_it_is_the_same(reference_model: Model) -> None:
    once = with_model_effects(dataclasses.replace(reference_model, effects=(ENTRY,)))
    i = reference_model.rack_to_rotor_ratio_rad_per_m
    assert once.rack_to_rotor_ratio_rad_per_m == i * (1.0 + SCALE)
    assert with_model_effects(once) == once


def test_no_power_is_lost_between_rack_and_rotor(reference_model: Model) -> None:
    """Virtual work: what load and hand do at the rack, whose position the simulation itself says,
    is what is missing from the work of motor, spring and friction on the rotor.
    """
    model = varying(reference_model)
    out = forward(model, driven(), physical=True).columns
    phi, x = out["motor_angle_rad"], out["rack_position_m"]
    assert np.ptp(1.0 + SCALE + 2 * SLOPE * x + 3 * BEND * x**2) > 0.1

    def work(force: np.ndarray, way: np.ndarray) -> np.ndarray:
        return np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(way))

    kinetic = 0.5 * model.inertia_kg_m2 * out["motor_speed_rad_s"] ** 2
    at_rotor = work(out["motor_torque_nm"] - out["friction_torque_nm"], phi)
    hand = model.pinion_ratio_rad_per_m * out["torque_sensor_nm"]
    at_rack = work(hand - out["rack_force_n"], x)
    stored = kinetic[1:] - kinetic[0]
    assert np.ptp(at_rack) > 1.0
    np.testing.assert_allclose(at_rotor + at_rack, stored, atol=2e-3 * np.ptp(at_rack))
    constant = work(hand - out["rack_force_n"], phi / model.rack_to_rotor_ratio_rad_per_m)
    assert np.max(np.abs(at_rotor + constant - stored)) > 0.02 * np.ptp(at_rack)


def test_friction_grows_with_the_force_at_the_rack_itself(reference_model: Model) -> None:
    """CONTRACT 8 has gain · |F|: what a force is worth at the rotor has no part in it."""
    n = 200
    x = np.linspace(0.01, 0.02, n)
    i = reference_model.rack_to_rotor_ratio_rad_per_m
    motion = Motion(
        np.linspace(0.0, 0.2, n), np.zeros(n), np.zeros(n), np.full(n, 800.0), x,
        np.full(n, 30.0), i * x, np.full(n, 0.03), np.full(n, 0.03), np.zeros(n),
    )  # fmt: skip
    plain = dataclasses.replace(reference_model, effects=(ENTRY,))
    more = {"effect": "load_dependent_friction", "gain_nm_per_n": 1e-4}
    loaded = dataclasses.replace(plain, effects=(ENTRY, more))
    grown = (residual_nm(plain, motion)[0] - residual_nm(loaded, motion)[0])[-50:]
    np.testing.assert_allclose(grown, 0.08, rtol=1e-6)


def test_a_ratio_that_turns_over_is_not_followed(reference_model: Model) -> None:
    """Far beyond what was seen the polynomial runs away; the position and the force do not."""
    wild = {**ENTRY, "slope_per_m": -20.0, "bend_per_m2": -2000.0}
    model = dataclasses.replace(reference_model, effects=(wild,))
    i = reference_model.rack_to_rotor_ratio_rad_per_m
    turned = np.linspace(-0.2, 0.2, 101) * i
    found = rack_position_m(model, turned)
    assert np.all(np.abs(found) <= 3.0 * np.abs(turned) / i)
    assert np.all(np.sign(found) == np.sign(turned))


Kind = Literal["observer", "bristle_filter", "smoother"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", get_args(Kind))
def test_the_estimator_tells_the_force_at_the_rack(reference_model: Model, kind: Kind) -> None:
    model = varying(reference_model, viscous_pos_nm_s_per_rad=1e-3, viscous_neg_nm_s_per_rad=1e-3)
    found = forward(model, driven())
    recorded = {name: Series(T_NS, one) for name, one in found.columns.items()}
    given = {
        name: recorded[name]
        for name in ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
    }

    def off_n(with_model: Model) -> float:
        trace = estimate(given, with_model, EstimatorSettings(kind=kind))
        force, speed = (
            np.interp(trace.t_ns * 1e-9, T, recorded[name].value)
            for name in ("rack_force_n", "motor_speed_rad_s")
        )
        good = trace.valid & (np.abs(speed) > 2.0) & (trace.t_ns > 500_000_000)
        return float(np.sqrt(np.mean((trace.rack_force_n - force)[good] ** 2)))

    middle = tuple(
        {"effect": e["effect"], **({"scale": SCALE} if e is ENTRY else e)} for e in model.effects
    )
    with_it, without = off_n(model), off_n(dataclasses.replace(model, effects=middle))
    assert with_it < 25.0
    assert without > 1.5 * with_it
