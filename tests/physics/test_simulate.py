"""The forward simulation against closed forms and against a rig of other code."""

import dataclasses
import math

import numpy as np
import pytest

from eps_hil.physics.model import Model
from eps_hil.physics.simulate import simulate


def frictionless(model: Model) -> Model:
    tiny = dataclasses.replace(
        model.friction,
        **{
            name: 0.0
            for name in (
                "offset_pos_nm", "offset_neg_nm", "viscous_pos_nm_s_per_rad",
                "viscous_neg_nm_s_per_rad", "load_pos_nm_per_n", "load_neg_nm_per_n",
                "sigma1_nm_s_per_rad",
            )
        },
    )  # fmt: skip
    return dataclasses.replace(model, friction=tiny)


def test_without_friction_newton_holds(reference_model: Model) -> None:
    model = frictionless(reference_model)
    t = np.linspace(0.0, 2.0, 2001)
    torque = 0.05 * np.sin(2 * math.pi * t)
    motion = simulate(model, t, torque, 0 * t, 0 * t)
    exact = 0.05 / model.inertia_kg_m2 / (2 * math.pi) * (1 - np.cos(2 * math.pi * t))
    # 1 µNm of friction floor, and inputs that are straight between samples
    assert np.max(np.abs(motion.speed_rad_s - exact)) < 2e-4 * np.max(exact) + 1e-6 / 2e-4 * 2


def test_positive_rack_force_opposes(reference_model: Model) -> None:
    t = np.linspace(0.0, 0.199, 200)
    motion = simulate(reference_model, t, 0 * t, 0 * t, np.full_like(t, 1000.0))
    assert motion.speed_rad_s[-1] < -10.0


def test_below_the_friction_level_it_sticks(reference_model: Model) -> None:
    t = np.linspace(0.0, 5.0, 5001)
    torque = np.full_like(t, 0.04)  # of 0.056 Nm
    motion = simulate(reference_model, t, torque, 0 * t, 0 * t)
    assert abs(motion.speed_rad_s[-1]) < 1e-3
    assert motion.friction_torque_nm[-1] == pytest.approx(0.04, rel=1e-3)
    assert motion.angle_rad[-1] < 0.06


def test_energy_balance(reference_model: Model) -> None:
    """∫(T − F/i)ω dt = ½Jω² + ∫T_f ω dt, with the integrals taken of the output itself."""
    t = np.linspace(0.0, 2.0, 20001)
    torque = 0.5 * np.sin(2 * math.pi * 1.5 * t)
    force = 400.0 * np.sin(2 * math.pi * 0.7 * t)
    motion = simulate(reference_model, t, torque, 0 * t, force)
    i, j = reference_model.rack_to_rotor_ratio_rad_per_m, reference_model.inertia_kg_m2
    put_in = np.trapezoid((torque - force / i) * motion.speed_rad_s, t)
    lost = np.trapezoid(motion.friction_torque_nm * motion.speed_rad_s, t)
    kinetic = 0.5 * j * motion.speed_rad_s[-1] ** 2
    assert put_in == pytest.approx(kinetic + lost, rel=2e-3)


def test_agrees_with_a_rig_of_other_code(reference_model: Model, sweep_truth: object) -> None:
    truth = sweep_truth
    speed, angle = truth.speed_rad_s, truth.angle_rad  # type: ignore[attr-defined]
    torque, time_s = truth.motor_torque_nm, truth.time_s  # type: ignore[attr-defined]
    motion = simulate(reference_model, time_s, torque, 0 * time_s, truth.rack_force_n)  # type: ignore[attr-defined]
    rms = float(np.sqrt(np.mean((motion.speed_rad_s - speed) ** 2)))
    assert rms < 1e-3 * float(np.std(speed))
    assert np.max(np.abs(motion.angle_rad - angle)) < 0.01 * np.ptp(angle)
