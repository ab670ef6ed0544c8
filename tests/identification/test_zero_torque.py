"""What a sensor reads with nothing on it: seen where it is so, and nowhere else."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.identification.offsets import Offset, offset
from eps_hil.identification.zero_torque import WINDOW_S, _kernel, readings, windows
from eps_hil.proof import sensors
from eps_hil.proof.programmes import programme
from eps_hil.proof.truth import Drive, Floats
from eps_hil.proof.world import World

RATIO = 20.0
"""rad of the rotor per rad of the wheel."""
NOISE_NM = 0.01
T = np.arange(12_000) * 1e-3
GOOD = np.ones(len(T), dtype=bool)
HZ = np.array([0.6, 1.1, 1.9])[:, None]
ANGLE = 20.0 * np.sum(np.sin(2 * np.pi * HZ * T + HZ) / HZ, axis=0)
SPEED = np.gradient(ANGLE, 1e-3)


def noise(seed: int = 1) -> Floats:
    return NOISE_NM * np.random.default_rng(seed).standard_normal(len(T))


def free_wheel(inertia: float, damping: float) -> Floats:
    """−J ψ̈ − d ψ̇, at the column."""
    return -(inertia * np.gradient(SPEED, 1e-3) + damping * SPEED) / RATIO


@settings(max_examples=40)
@given(
    inertia=st.floats(0.0, 0.1),
    damping=st.floats(0.0, 0.3),
    offset=st.floats(-0.4, 0.4),
    seed=st.integers(0, 99),
)
def test_a_free_wheel_shows_the_sensors_offset(
    inertia: float, damping: float, offset: float, seed: int
) -> None:
    torque = free_wheel(inertia, damping) + offset + noise(seed)
    found = readings(torque, SPEED, GOOD, NOISE_NM, RATIO)
    assert len(found) == int((len(T) * 1e-3 - 0.3) / WINDOW_S)
    assert np.median(found) == pytest.approx(offset, abs=3e-3)


@pytest.mark.parametrize(
    "torque",
    [
        2.0 * np.sin(2 * np.pi * 0.3 * T),  # a hand
        8.0 * ANGLE / RATIO,  # a hand against the spring of a parked car: in step with the motion
        0.3 * SPEED / RATIO + 0.2,  # a hand that drives
        1.0 * np.sign(np.sin(2 * np.pi * 0.9 * T)),
    ],
)
def test_a_hand_at_the_wheel_is_no_reading(torque: Floats) -> None:
    assert readings(torque + noise(), SPEED, GOOD, NOISE_NM, RATIO) == []


def test_a_motor_that_is_off_reads_its_offset_and_one_that_damps_does_not() -> None:
    found = readings(0.004 + noise(), SPEED, GOOD, NOISE_NM)
    assert np.mean(found) == pytest.approx(0.004, abs=1e-3)
    assert readings(-3e-4 * SPEED + noise(), SPEED, GOOD, NOISE_NM) == []
    assert readings(free_wheel(0.05, 0.1) + noise(), SPEED, GOOD, NOISE_NM) == []


def test_what_is_slower_than_a_wheel_swings_passes_by_half_at_3_3_hz() -> None:
    response = np.abs(np.fft.rfft(_kernel(), 1 << 16))
    hz = np.fft.rfftfreq(1 << 16, 1e-3)
    assert hz[np.argmax(response < 0.5)] == pytest.approx(3.3, abs=0.05)


def test_nothing_from_rest_from_bad_data_or_from_a_constant_in_a_file() -> None:
    torque = free_wheel(0.04, 0.1) + noise()
    assert readings(torque, np.zeros(len(T)), GOOD, NOISE_NM, RATIO) == []
    assert readings(torque, SPEED, ~GOOD, NOISE_NM, RATIO) == []
    holes = GOOD.copy()
    holes[1000::2000] = False
    assert readings(torque, SPEED, holes, NOISE_NM, RATIO) == []
    assert readings(np.zeros(len(T)), SPEED, GOOD, 0.0, RATIO) == []
    assert readings(torque[:200], SPEED[:200], GOOD[:200], NOISE_NM, RATIO) == []


@pytest.mark.parametrize(("name", "free"), [("training", True), ("never_free", False)])
def test_on_a_truth_plant_with_a_wheel_on_its_bar(name: str, free: bool) -> None:
    """Five masses, a wheel that swings at 8 Hz: all hands-off stretches, and no other."""
    rng = np.random.default_rng(4)
    world = World(simple=False)
    ratio = Drive().rack_rad_per_m / Drive().pinion_rad_per_m
    torque, motor = [], []
    for program in programme(name, rng):
        truth = world.run(program)
        seen = sensors.measured(sensors.reported(truth, world.instruments), world.instruments, rng)
        speed, good = seen["motor_speed_rad_s"], np.ones(len(seen["time_s"]), dtype=bool)
        torque += readings(seen["torque_sensor_nm"], speed, good, 1e-2, ratio)
        motor += readings(seen["motor_torque_nm"], speed, good, 4e-3)
    assert (len(torque) > 20, len(motor) > 3) == (free, free)
    if free:
        assert np.median(torque) == pytest.approx(0.0, abs=1e-3)
        assert np.max(np.abs(torque)) < 0.03
        assert np.max(np.abs(motor)) < 5e-4


@pytest.mark.parametrize("friction_nm", [0.05, 0.15])
def test_a_wheel_whose_bearings_rub_is_a_free_wheel_too(friction_nm: float) -> None:
    """Driven more one way than the other, its friction has a mean that is no offset."""
    uneven = SPEED + 6.0
    torque = free_wheel(0.04, 0.0) - friction_nm * np.tanh(uneven / 0.5) + 0.1 + noise()
    found = readings(torque, uneven, GOOD, NOISE_NM, RATIO)
    assert len(found) == 5
    assert np.max(np.abs(np.array(found) - 0.1)) < 0.02
    assert np.median(found) == pytest.approx(0.1, abs=5e-3)


def with_motor_off(off_s: float, seed: int) -> Offset | None:
    """What is found of an offset of 4 mNm where the motor is off for so long, and works then."""
    torque = np.where(off_s > T, 0.004, 0.3 * np.sin(9.0 * T)) + noise(seed)
    recording = SimpleNamespace(
        has=lambda _signal: True,
        density={"motor_torque_nm": 2e-3 * NOISE_NM**2},
        raw={"motor_torque_nm": torque},
        good=GOOD,
    )
    case: Any = SimpleNamespace(recording=recording, motion=SimpleNamespace(speed=SPEED))
    return offset([case], "motor_torque_nm", RATIO)


def test_six_seconds_with_the_motor_off_are_enough() -> None:
    """Three windows, whose interval is as wide as so few make it: it holds the offset."""
    found = [with_motor_off(6.9, seed) for seed in range(60)]
    seen = [one for one in found if one is not None]
    assert len(seen) > 50
    assert all(one.seconds == 6.0 for one in seen)
    assert sum(one.ci95[0] < 0.004 < one.ci95[1] for one in seen) > 0.88 * len(seen)
    assert max(abs(one.value - 0.004) for one in seen) < 2e-3
    assert all(with_motor_off(5.0, seed) is None for seed in range(10))


@pytest.mark.parametrize("hertz", [0.1, 0.125])
@pytest.mark.parametrize("friction_nm", [0.0, 0.08])
def test_a_slow_turn_is_one_window_and_reads_the_offset(hertz: float, friction_nm: float) -> None:
    """In 2 s of it the wheel's inertia, its bearings and an offset look alike."""
    t = np.arange(24_000) * 1e-3
    speed = 15.0 * np.sin(2 * np.pi * hertz * t + 0.3)
    torque = 0.1 - 0.04 * np.gradient(speed, 1e-3) / RATIO - friction_nm * np.tanh(speed / 0.5)
    torque += NOISE_NM * np.random.default_rng(0).standard_normal(len(t))
    found = windows(torque, speed, np.ones(len(t), dtype=bool), NOISE_NM, RATIO)
    assert len(found) >= 4
    assert np.max(np.abs(np.array([one.value for one in found]) - 0.1)) < 5e-3
    assert max(one.seconds for one in found) > WINDOW_S


def test_hands_that_held_a_torque_elsewhere_do_not_hide_the_hands_off_stretches() -> None:
    """24 s hands off, and 18 s in which a hand holds one torque after another."""
    t = np.arange(42_000) * 1e-3
    speed = 15.0 * np.sin(2 * np.pi * 0.5 * t)
    held = np.repeat([0.4, -0.5, 0.7], 6000)
    torque = np.concatenate([np.full(24_000, 0.05), held])
    torque += NOISE_NM * np.random.default_rng(0).standard_normal(len(t))
    recording = SimpleNamespace(
        has=lambda _signal: True,
        density={"torque_sensor_nm": 2e-3 * NOISE_NM**2},
        raw={"torque_sensor_nm": torque},
        good=np.ones(len(t), dtype=bool),
    )
    case: Any = SimpleNamespace(recording=recording, motion=SimpleNamespace(speed=speed))
    found = offset([case], "torque_sensor_nm", RATIO)
    assert found is not None
    assert found.value == pytest.approx(0.05, abs=2e-3)
    assert found.ci95[0] < 0.05 < found.ci95[1]
    assert 16.0 <= found.seconds <= 24.0
