"""A ripple's phase is read from a recording whose load nobody knows."""

from dataclasses import replace

import numpy as np
import pytest

from eps_hil.axis.emps import ARM_M, COULOMB_N, MASS_KG, VISCOUS_N_S_PER_M, AxisRecord
from eps_hil.axis.emps import published_model as published
from eps_hil.axis.phase import rephased
from eps_hil.physics.model import Model

ORDER, AMPLITUDE_N = 4.0, 0.8
SWING_M, PERIOD_S = 0.1, 4.0


def _model(phase_rad: float) -> Model:
    ripple = {
        "effect": "cogging_torque",
        "amplitude_nm": AMPLITUDE_N * ARM_M,
        "order": ORDER,
        "phase_rad": phase_rad,
    }
    model = published()
    friction = replace(
        model.friction, offset_pos_nm=COULOMB_N * ARM_M, offset_neg_nm=COULOMB_N * ARM_M
    )
    return replace(model, friction=friction, effects=(ripple,))


def _record(phase_rad: float, hidden_n: float, *, swing_m: float = SWING_M) -> AxisRecord:
    """The axis in a cosine, its force written down from the balance, with noise of 1 N."""
    t = np.arange(20_000) * 1e-3
    turn = 2 * np.pi / PERIOD_S
    x = -swing_m * np.cos(turn * t)
    v, a = swing_m * turn * np.sin(turn * t), swing_m * turn**2 * np.cos(turn * t)
    hidden = np.where((t % 3.0) < 1.0, hidden_n, 0.0)
    friction = VISCOUS_N_S_PER_M * v + COULOMB_N * np.sign(v)
    ripple = AMPLITUDE_N * np.sin(ORDER * x / ARM_M + phase_rad)
    noise = np.random.default_rng(3).normal(0.0, 1.0, len(t))
    return AxisRecord("made", x, MASS_KG * a + friction + ripple + hidden + noise, hidden)


@pytest.mark.parametrize("phase_rad", [-2.5, 0.4, 3.0])
def test_the_phase_is_found_under_a_load_that_is_two_hundred_times_as_large(
    phase_rad: float,
) -> None:
    record = _record(phase_rad, 170.0)
    found = rephased(record, _model(0.0)).effects[0]
    off = np.angle(np.exp(1j * (found["phase_rad"] - phase_rad)))
    assert abs(off) < 0.15
    assert found["amplitude_nm"] == AMPLITUDE_N * ARM_M


def test_the_withheld_force_is_not_looked_at() -> None:
    record = _record(0.4, 170.0)
    blind = replace(record, hidden_force_n=np.zeros(len(record.force_n)))
    assert rephased(record, _model(0.0)) == rephased(blind, _model(0.0))


def test_a_recording_that_hardly_moves_keeps_the_phase_that_was_given() -> None:
    record = _record(0.4, 0.0, swing_m=1e-4)
    model = _model(1.0)
    assert rephased(record, model) == model


def test_other_effects_are_left_alone() -> None:
    model = replace(published(), effects=({"effect": "motor_torque_delay", "delay_s": 1e-3},))
    assert rephased(_record(0.4, 0.0), model) == model
