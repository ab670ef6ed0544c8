"""Rotor and rack with a joint between them: limit cases, closed forms, energy."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from eps_hil.physics.effects.catalogue import joint_of
from eps_hil.physics.effects.effect import RIGID, Joint
from eps_hil.physics.forward import forward
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import Motion, simulate
from eps_hil.physics.two_masses import joint_torque_nm
from eps_hil.series import Series

T = np.arange(0.0, 3.0, 1e-3)
FORCE = 500.0 * np.sin(2 * math.pi * 0.5 * T)
MOTOR = FORCE / 2513.0 + 0.25 * np.sin(2 * math.pi * 0.9 * T + 0.3)
HAND = 1.0 * np.sin(2 * math.pi * 0.7 * T)


def run(model: Model, *entries: dict[str, Any]) -> Motion:
    spring = {"effect": "unmodelled_spring", "stiffness_nm_per_rad": 0.03}
    changed = dataclasses.replace(model, effects=(spring, *entries))
    return simulate(changed, T, MOTOR, HAND, FORCE)


def belt(stiffness: float, damping: float = 0.02) -> dict[str, Any]:
    return {
        "effect": "belt_compliance",
        "stiffness_nm_per_rad": stiffness,
        "damping_nm_s_per_rad": damping,
    }


def test_a_stiff_belt_is_the_one_mass_model(reference_model: Model) -> None:
    rigid, stiff = run(reference_model), run(reference_model, belt(1000.0, 0.05))
    assert np.max(np.abs(stiff.speed_rad_s - rigid.speed_rad_s)) < 0.02 * np.max(
        np.abs(rigid.speed_rad_s)
    )
    assert np.max(np.abs(stiff.rack_rad - stiff.angle_rad)) < 2e-3


def test_no_gap_is_no_backlash(reference_model: Model) -> None:
    closed, plain = run(reference_model, {"effect": "backlash", "gap_rad": 0.0}), None
    plain = run(reference_model, belt(RIGID.stiffness_nm_per_rad, RIGID.damping_nm_s_per_rad))
    assert np.array_equal(closed.speed_rad_s, plain.speed_rad_s)
    assert np.array_equal(closed.rack_rad, plain.rack_rad)


@pytest.mark.parametrize("stiffness", [8.0, 20.0, 60.0])
def test_the_twist_is_torque_over_stiffness(reference_model: Model, stiffness: float) -> None:
    """φ − i_APA·x = τ/stiffness, with τ worked out from the rack side's own motion."""
    got = run(reference_model, belt(stiffness))
    behind = RIGID.behind_share * reference_model.inertia_kg_m2
    acceleration = np.gradient(np.gradient(got.rack_rad, 1e-3), 1e-3)
    outer = reference_model.sensor_to_rotor * HAND - FORCE / 2513.0
    torque = behind * acceleration - outer
    twist, inner = got.angle_rad - got.rack_rad, slice(200, -200)
    error = np.abs(twist - torque / stiffness)[inner]
    assert np.median(error) < 0.02 * np.std(torque) / stiffness


def test_the_sensitivity_to_stiffness_is_the_closed_forms(reference_model: Model) -> None:
    """∂twist/∂stiffness by finite difference against −τ/stiffness², where the motion is slow."""
    stiffness, step = 20.0, 0.2
    low, high = (run(reference_model, belt(stiffness + s)) for s in (-step, step))
    twist = [one.angle_rad - one.rack_rad for one in (low, high)]
    slope = (twist[1] - twist[0]) / (2 * step)
    expected = -0.5 * (twist[0] + twist[1]) / stiffness
    inner = slice(300, -300)
    scale = float(np.std(expected[inner]))
    assert np.median(np.abs(slope - expected)[inner]) < 0.05 * scale


@pytest.mark.parametrize("gap", [0.05, 0.2, 1.0])
def test_backlash_is_bimodal(reference_model: Model, gap: float) -> None:
    """The rotor leans on one or the other side; never further apart than gap and spring allow."""
    got = run(reference_model, {"effect": "backlash", "gap_rad": gap})
    twist = got.angle_rad - got.rack_rad
    assert np.max(np.abs(twist)) < 0.5 * gap + 0.02  # what an impact presses in
    leaning = np.abs(np.abs(twist) - 0.5 * gap) < 2e-3
    assert np.mean(leaning) > 0.6
    assert twist.max() > 0.45 * gap
    assert twist.min() < -0.45 * gap


def test_the_sensitivity_to_the_gap_is_one_half_a_side(reference_model: Model) -> None:
    wide, narrow = (
        run(reference_model, {"effect": "backlash", "gap_rad": gap}) for gap in (0.11, 0.10)
    )
    twist = [one.angle_rad - one.rack_rad for one in (wide, narrow)]
    both = (np.abs(twist[0]) > 0.055) & (np.abs(twist[1]) > 0.05)
    both &= np.sign(twist[0]) == np.sign(twist[1])
    slope = (np.abs(twist[0]) - np.abs(twist[1]))[both] / 0.01
    assert np.median(slope) == pytest.approx(0.5, abs=0.01)


def test_an_open_gap_passes_nothing_and_a_joint_never_pulls() -> None:
    joint = Joint(100.0, 1.0, 0.2, 0.33)
    assert joint_torque_nm(joint, 0.05, 3.0) == 0.0
    assert joint_torque_nm(joint, 0.11, -50.0) == 0.0
    assert joint_torque_nm(joint, 0.2, 0.0) == pytest.approx(10.0)
    assert joint_torque_nm(joint, -0.2, 0.0) == pytest.approx(-10.0)


def test_belt_and_backlash_share_one_joint(reference_model: Model) -> None:
    entries = (belt(12.0), {"effect": "backlash", "gap_rad": 0.3})
    joint = joint_of(dataclasses.replace(reference_model, effects=entries))
    assert joint == Joint(12.0, 0.02, 0.3, RIGID.behind_share)
    assert joint_of(reference_model) is None


def test_the_undamped_joint_keeps_its_energy(reference_model: Model) -> None:
    """Free oscillation without friction: frequency and amplitude of the closed form."""
    tiny = {name: 0.0 for name in ("offset_pos_nm", "offset_neg_nm", "viscous_pos_nm_s_per_rad",
            "viscous_neg_nm_s_per_rad", "load_pos_nm_per_n", "load_neg_nm_per_n",
            "sigma1_nm_s_per_rad")}  # fmt: skip
    free = dataclasses.replace(
        reference_model,
        friction=dataclasses.replace(reference_model.friction, **tiny),
        effects=(belt(5.0, 0.0),),
    )
    t = np.arange(0.0, 0.5, 2e-4)
    zero = np.zeros(len(t))
    got = simulate(free, t, zero, zero, zero, speed_rad_s=10.0)
    twist = got.angle_rad - got.rack_rad
    share = RIGID.behind_share
    reduced = reference_model.inertia_kg_m2 * share * (1 - share)
    omega = math.sqrt(5.0 / reduced)
    # both start at 10 rad/s: nothing twists; the rotor alone kicked would
    assert np.max(np.abs(twist)) < 1e-6
    motor = np.where(t < 1e-3, 1.0, 0.0)
    got = simulate(free, t, motor, zero, zero)
    twist = (got.angle_rad - got.rack_rad)[50:]
    crossings = np.flatnonzero(np.diff(np.sign(twist)) > 0)
    period = float(np.mean(np.diff(t[50:][crossings])))
    assert 2 * math.pi / period == pytest.approx(omega, rel=0.01)
    first, last = np.max(twist[:600]), np.max(twist[-600:])
    assert last == pytest.approx(first, rel=0.03)


def test_the_rack_position_shows_the_joint(reference_model: Model) -> None:
    """``simulate`` writes what a rig would record: rotor angle and rack position apart."""
    t_ns = np.round(T * 1e9).astype(np.int64)
    inputs = {
        name: Series(t_ns, values)
        for name, values in (
            ("motor_torque_nm", MOTOR), ("torque_sensor_nm", HAND), ("rack_force_n", FORCE),
        )
    }  # fmt: skip
    model = dataclasses.replace(reference_model, effects=({"effect": "backlash", "gap_rad": 0.4},))
    columns = forward(model, inputs, physical=True).columns
    apart = columns["motor_angle_rad"] - 2513.0 * columns["rack_position_m"]
    assert 0.19 < np.max(np.abs(apart)) < 0.22
