"""Noise below the cut-off, where a signal's is not white: a speed counted from encoder steps."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from eps_hil.diagnosis.balance.baseline import ALL
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.noise import noise_at_1_khz, noise_of
from eps_hil.diagnosis.data.prepare import CUTOFF_HZ, STEP_S, Prepared, prepare
from eps_hil.identification.butterworth import low_pass, passed
from eps_hil.physics.model import Delays, Friction, Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

INERTIA, LEVEL_NM, DRAG = 1.2e-4, 0.03, 7e-5


def series(values: Floats) -> Series:
    """At 1 kHz."""
    return Series(np.arange(len(values), dtype=np.int64) * 1_000_000, values)


def turned(torque: Floats) -> Floats:
    """The angle of a rotor under a torque that holds it on its way, at 1 kHz."""
    speed, angle = 0.0, np.zeros(len(torque))
    for k, one in enumerate(torque[:-1].tolist()):
        moves = speed != 0.0 or abs(one) > LEVEL_NM
        friction = LEVEL_NM * np.sign(speed or one) + DRAG * speed
        faster = speed + moves * (one - friction) / INERTIA * STEP_S
        angle[k + 1] = angle[k] + 0.5 * (speed + faster) * STEP_S
        speed = faster
    return angle


def counted(counts: int, way: float, seed: int) -> Prepared:
    """Steps of torque, an encoder of so many counts a turn, its differences for a speed."""
    rng = np.random.default_rng(seed)
    torque = way * (0.035 + 0.006 * np.cumsum(np.arange(16_000) % 4000 == 2000))
    torque[:300] = 0.0
    step = 2.0 * np.pi / counts
    angle = np.floor(turned(torque) / step) * step
    told = {
        "motor_angle_rad": angle,
        "motor_speed_rad_s": np.diff(angle, prepend=angle[0]) / STEP_S,
        "motor_torque_nm": torque + 0.015 * rng.standard_normal(len(torque)),
    }
    return prepare(f"counted {seed}", {name: series(one) for name, one in told.items()})


@pytest.mark.parametrize("derivatives", [0, 1, 2])
def test_white_noise_stays_what_it_is(derivatives: int) -> None:
    t = np.arange(20_000) * STEP_S
    motion = 50.0 * np.sin(4.0 * t) + 10.0 * t
    noisy = motion + 0.2 * np.random.default_rng(1).standard_normal(len(t))
    found = noise_at_1_khz(series(noisy), moving=True, derivatives=derivatives)
    assert found == pytest.approx(noise_of(noisy), rel=1e-3)


def test_noise_that_grows_with_frequency_is_as_strong_as_it_is_below() -> None:
    """As a derivative has it that went through the balance's filter."""
    t = np.arange(20_000) * STEP_S
    angle = 30.0 * t + 5.0 * np.sin(4.0 * t)
    step = 6e-4
    noise = np.diff(np.floor(angle / step) * step - angle, prepend=0.0)[1:] / STEP_S
    speed = np.diff(angle) / STEP_S + noise
    left = float(np.std(low_pass(np.gradient(noise, STEP_S), CUTOFF_HZ)[500:-500]))
    white, found = (
        one * float(np.sqrt(passed(CUTOFF_HZ, 2)))
        for one in (noise_of(speed), noise_at_1_khz(series(speed), moving=True, derivatives=1))
    )
    assert white > 4.0 * left
    assert left < 1.1 * found < 1.7 * left


def test_inertia_beside_a_counted_speed(reference_model: Model) -> None:
    """Taken for white, its noise makes it 1.6 times as large, and no interval holds it."""
    friction = Friction(LEVEL_NM, LEVEL_NM, DRAG, DRAG, 0.0, 0.0, 1.5, 0.0, 0.75)
    model = replace(
        reference_model, inertia_kg_m2=INERTIA, friction=friction, delays_s=Delays(), effects=()
    )
    problem = Problem([counted(10_000, way, k) for k, way in enumerate((1.0, -1.0))], model)
    found = problem.with_entries([], fit(problem, [], own=ALL).own).inertia_kg_m2
    assert found == pytest.approx(INERTIA, rel=0.15)
