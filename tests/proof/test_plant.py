"""The truth plant against closed forms: what can be computed by hand must come out."""

import math

import numpy as np
import pytest

from eps_hil.proof import manoeuvres
from eps_hil.proof.plant import PROGRAM, run
from eps_hil.proof.truth import (
    Chain,
    Drive,
    Floats,
    Hidden,
    Slip,
    five_masses,
    lugre,
    maxwell_slip,
    one_mass,
    two_masses,
)

FREE = Drive(k0_pos=0, k0_neg=0, kw_pos=0, kw_neg=0, kr_pos=0, kr_neg=0, sigma0=0, sigma1=0)
"""A drive without friction."""
REFERENCE = Drive()


def _program(seconds: float, **columns: Floats | float) -> Floats:
    program = np.zeros((round(seconds * 1000), len(PROGRAM)))
    for name, values in columns.items():
        program[:, PROGRAM.index(name)] = values
    return program


def _without_friction(chain: Chain, program: Floats, **hidden: float) -> dict[str, Floats]:
    return run(FREE, Hidden(**hidden), chain, lugre(), program)


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 5])
def test_constant_torque_accelerates_the_whole_inertia(order: int) -> None:
    chain = one_mass(FREE) if order == 1 else five_masses(FREE)._replace(wheel_inertia=0.0)
    truth = _without_friction(chain, _program(0.5, feed_nm=0.01))
    slope = np.polyfit(np.arange(100, 499) * 1e-3, truth["motor_speed_rad_s"][100:499], 1)[0]
    assert slope == pytest.approx(0.01 / FREE.inertia_kg_m2, rel=1e-3)


def test_rack_force_and_hand_torque_act_through_their_ratios() -> None:
    balanced = _program(0.3, force_n=1000.0, hand_nm=1000.0 / FREE.pinion_rad_per_m)
    truth = _without_friction(one_mass(FREE), balanced)
    assert np.abs(truth["motor_speed_rad_s"]).max() < 1e-6
    assert truth["torque_sensor_nm"][10] == pytest.approx(1000.0 / 125.7)


def test_a_motor_that_is_off_turns_freely_and_reads_its_offset() -> None:
    off = np.where(np.arange(600) < 300, 0.0, 1.0)
    program = _program(0.6, feed_nm=0.01, motor_off=off)
    truth = _without_friction(one_mass(FREE), program, motor_offset_nm=0.004, motor_gain=0.8)
    speed, torque = truth["motor_speed_rad_s"], truth["motor_torque_nm"]
    driven = (0.8 * 0.01 + 0.004) / FREE.inertia_kg_m2
    assert np.polyfit(np.arange(50, 290) * 1e-3, speed[50:290], 1)[0] == pytest.approx(driven, 1e-3)
    assert np.ptp(speed[301:]) < 1e-9
    assert torque[301:] == pytest.approx(np.full(len(torque[301:]), -0.004 / 0.8))


def test_motor_as_a_spring_swings_at_its_frequency() -> None:
    stiffness = FREE.inertia_kg_m2 * (2 * math.pi * 2.0) ** 2
    target = np.where(np.arange(4000) < 5, 0.0, 1.0)
    program = _program(4.0, target_rad=target, motor_nm_per_rad=stiffness)
    angle = _without_friction(one_mass(FREE), program)["motor_angle_rad"] - 1.0
    upward = np.flatnonzero((angle[:-1] < 0) & (angle[1:] >= 0))
    assert float(np.diff(upward).mean()) == pytest.approx(500, abs=2)


def test_belt_swings_at_the_frequency_of_two_masses() -> None:
    chain = two_masses(FREE, stiffness=5.0, damping=0.0)
    a, b = chain.inertia
    expected_hz = math.sqrt(5.0 * (a + b) / (a * b)) / (2 * math.pi)
    kick = np.where(np.arange(4000) < 3, 0.5, 0.0)
    truth = _without_friction(chain, _program(4.0, feed_nm=kick))
    twist = truth["motor_angle_rad"] - truth["rack_position_m"] * FREE.rack_rad_per_m
    spectrum = np.abs(np.fft.rfft(twist[100:] - twist[100:].mean()))
    hz = np.fft.rfftfreq(len(twist) - 100, 1e-3)
    assert hz[spectrum.argmax()] == pytest.approx(expected_hz, abs=0.5)


def test_backlash_opens_by_its_whole_width() -> None:
    chain = two_masses(FREE, stiffness=400.0, damping=0.05, gap_rad=0.2)
    force = 200 * np.sin(2 * np.pi * 2 * np.arange(2000) * 1e-3)
    program = _program(2.0, force_n=force, motor_nm_per_rad=0.3, motor_nm_s_per_rad=5e-3)
    truth = _without_friction(chain, program)
    twist = truth["motor_angle_rad"] - truth["rack_position_m"] * FREE.rack_rad_per_m
    assert np.ptp(twist[200:]) == pytest.approx(0.2, abs=0.01)


def test_friction_on_the_rack_holds_the_rack_and_not_the_rotor() -> None:
    gap = two_masses(REFERENCE, stiffness=400.0, damping=0.05, gap_rad=0.4)
    push = _program(3.0, feed_nm=0.02, motor_nm_s_per_rad=0.1)
    moved = {}
    for behind, chain in ((False, gap), (True, gap._replace(rubs=gap.rack))):
        truth = run(REFERENCE, Hidden(), chain, lugre(), push)
        moved[behind] = truth["motor_angle_rad"][-1]
    assert moved[False] < 0.02  # 0.02 Nm is less than the breakaway torque
    assert moved[True] == pytest.approx(0.2, abs=0.02)


def test_a_weight_hangs_where_it_balances_the_motor() -> None:
    weight = dict.fromkeys(("weight_n",), 500.0) | {"weight_rad_per_m": 40.0, "weight_rad": 0.3}
    feed = 300.0 / FREE.rack_rad_per_m
    held = _program(20.0, feed_nm=feed, motor_nm_s_per_rad=4e-3, **weight)
    place = _without_friction(one_mass(FREE), held)["rack_position_m"][-1]
    assert 500.0 * math.sin(40.0 * place + 0.3) == pytest.approx(300.0, rel=1e-3)


def test_scrub_is_a_spring_at_first_and_slides_at_its_level() -> None:
    ramp = np.linspace(0.0, 30.0, 3000)  # 12 mm, more than ten times what it gives way
    program = _program(
        3.0, target_rad=ramp, motor_nm_per_rad=0.5, motor_nm_s_per_rad=4e-3,
        scrub_n=400.0, scrub_m=1e-3,
    )  # fmt: skip
    truth = _without_friction(one_mass(FREE), program)
    place, force = truth["rack_position_m"], truth["rack_force_n"]
    expected = 400.0 * (1.0 - np.exp(-place / 1e-3))  # dz = (1 - z) dx on the way out
    assert np.abs(force - expected).max() < 2.0
    assert force[-2] == pytest.approx(400.0, rel=1e-3)


@pytest.mark.parametrize(
    ("direction", "offset", "load"), [(1, 0.056, 4.993e-5), (-1, 0.1258, 4.345e-5)]
)
@pytest.mark.parametrize("slip", [lugre(), maxwell_slip()], ids=["lugre", "maxwell"])
def test_sliding_friction_is_the_level_of_equation_3(
    direction: int, offset: float, load: float, slip: Slip
) -> None:
    speed, force = 20.0, 1000.0
    ramp = np.linspace(0.0, direction * speed * 2.0, 2000)
    program = _program(
        2.0, force_n=force, target_rad=ramp, motor_nm_per_rad=0.5, motor_nm_s_per_rad=4e-3,
        feed_nm=force / REFERENCE.rack_rad_per_m,
    )  # fmt: skip
    truth = run(REFERENCE, Hidden(), one_mass(REFERENCE), slip, program)
    reached = float(truth["motor_speed_rad_s"][-200:].mean())
    viscous = REFERENCE.kw_pos if direction > 0 else REFERENCE.kw_neg
    expected = direction * (offset + viscous * abs(reached) + load * force)
    assert float(truth["friction_torque_nm"][-200:].mean()) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("slip", [lugre(), maxwell_slip()], ids=["lugre", "maxwell"])
@pytest.mark.parametrize("masses", [1, 5])
@pytest.mark.parametrize("behind", [False, True])
def test_no_energy_comes_from_nowhere(slip: Slip, masses: int, behind: bool) -> None:
    chain = one_mass(REFERENCE) if masses == 1 else five_masses(REFERENCE)
    chain = chain._replace(rubs=chain.rack if behind else 0)
    program = manoeuvres.sweep(np.random.default_rng(1), 6.0)
    truth = run(REFERENCE, Hidden(viscous=1e-4), chain, slip, program)
    stored = truth["kinetic_j"] + truth["elastic_j"]
    in_bristles = 0.02  # J: no more than T_fs²/σ0 can be in them, and it is not counted
    balance = truth["work_in_j"] - truth["friction_j"] - stored
    assert truth["work_in_j"][-1] > 5.0
    assert np.abs(balance).max() < in_bristles + 0.01 * truth["work_in_j"][-1]


def test_one_mass_is_right_for_the_stiff_chain_of_five() -> None:
    program = manoeuvres.weave(np.random.default_rng(2), 4.0)
    chain = five_masses(REFERENCE)
    truth = run(REFERENCE, Hidden(), chain, lugre(), program)
    drive = truth["motor_torque_nm"] + 125.7 / 2513 * truth["torque_sensor_nm"]
    acceleration = np.gradient(truth["motor_speed_rad_s"]) * 1000
    rest = drive - truth["rack_force_n"] / 2513 - truth["friction_torque_nm"]
    rest -= REFERENCE.inertia_kg_m2 * acceleration
    assert float(np.sqrt(np.mean(rest[200:-2] ** 2))) < 1e-3


def test_motor_dead_time_delays_the_shaft() -> None:
    pulse = np.where(np.arange(300) < 100, 0.0, 0.05)
    prompt = _without_friction(one_mass(FREE), _program(0.3, feed_nm=pulse))
    late = _without_friction(one_mass(FREE), _program(0.3, feed_nm=pulse), motor_late_s=0.0125)
    lost = prompt["motor_speed_rad_s"][-1] - late["motor_speed_rad_s"][-1]
    assert lost == pytest.approx(0.0125 * 0.05 / FREE.inertia_kg_m2, rel=1e-3)
    assert np.array_equal(prompt["motor_torque_nm"], late["motor_torque_nm"])
