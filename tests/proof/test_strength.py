"""Effect-to-noise is what can be worked out by hand, and naive methods get a fair chance."""

import numpy as np
import pytest

from eps_hil.proof import manoeuvres
from eps_hil.proof.cases import Case
from eps_hil.proof.concealment import evidence
from eps_hil.proof.effects import find
from eps_hil.proof.naive import naive
from eps_hil.proof.sensors import late, measured, play, reported
from eps_hil.proof.strength import noise_rms, strength
from eps_hil.proof.truth import Drive, Floats
from eps_hil.proof.world import Instruments, World

D = Drive()


def _drive(seed: int) -> Floats:
    rng = np.random.default_rng(seed)
    return np.concatenate([manoeuvres.weave(rng, 8.0), manoeuvres.sweep(rng, 8.0)])


def _clean(
    effect: str = "", value: float = 0.0, seed: int = 1, **shape: float
) -> dict[str, Floats]:
    world = World(True)
    if effect:
        world = find(effect).apply(world, value, shape)
    return reported(world.run(_drive(seed)), world.instruments)


def test_nothing_hidden_leaves_nothing_over() -> None:
    assert strength(D, [_clean()], 5e-3).raw_ratio < 0.12


def test_a_ripple_is_as_strong_as_its_rms() -> None:
    """Screw ripple passes the filter whole at these speeds, and no parameter imitates it."""
    seen = strength(D, [_clean("screw_ripple", 0.02, phase_rad=0.3)], 0.02 / np.sqrt(2))
    assert seen.raw_ratio == pytest.approx(1.0, rel=0.15)
    assert seen.ratio > 0.85 * seen.raw_ratio


@pytest.mark.parametrize(
    ("effect", "value"), [("inertia", 0.2), ("motor_torque_offset", 0.02), ("coulomb_level", 0.2)]
)
def test_what_a_refit_can_take_away_does_not_count(effect: str, value: float) -> None:
    seen = strength(D, [_clean(effect, value)], 5e-3)
    assert seen.raw_ratio > 1.0
    assert seen.ratio < 0.2 * seen.raw_ratio


def test_noise_of_the_torque_balance_is_that_of_its_signals() -> None:
    """White noise of rms s below a cut f_c of the band f_s/2 keeps √(2 f_c/f_s) of it; its
    derivative s·2π·√(2 f_c³/3 f_s). The filter's skirts make it a little more."""
    i, cut = Instruments(), 80.0
    clean = _clean()
    found = noise_rms(D, clean, measured(clean, i, np.random.default_rng(1)))
    share = np.sqrt(2 * cut / 1000)
    static = np.sqrt(4e-3**2 + (1e-2 * 125.7 / 2513) ** 2 + (3.0 / 2513) ** 2) * share
    inertial = 2e-4 * 0.25 * 2 * np.pi * np.sqrt(2 * cut**3 / 3 / 1000)
    assert found == pytest.approx(float(np.hypot(static, inertial)), rel=0.15)


def test_delays_and_play_of_the_sensors() -> None:
    t = np.arange(2000) * 1e-3
    wave = np.sin(2 * np.pi * 3 * t)
    shifted = late(wave, 0.0123)[100:-100]
    assert shifted == pytest.approx(np.sin(2 * np.pi * 3 * (t - 0.0123))[100:-100], abs=1e-6)
    loose = play(wave, 0.2)
    assert np.abs(loose - wave).max() == pytest.approx(0.2)
    assert loose[500:].max() == pytest.approx(0.8, abs=1e-3)


def test_err_finds_what_stands_clear_of_the_noise() -> None:
    rng = np.random.default_rng(2)
    shape = {"order": 4.0, "phase_rad": 0.5}
    drives = [_clean("cogging_torque", 0.03, seed, **shape) for seed in (1, 2, 3)]
    noisy = [measured(one, Instruments(), rng) for one in drives]
    assert naive(D, noisy[:2], noisy[2]).err[0] == "cogging_torque"


def test_evidence_says_that_a_weak_effect_is_concealed(stribeck_case: Case) -> None:
    facts = stribeck_case.answer["concealment"]
    assert facts["wrong_model_fit_percent"] > 90
    assert 0 <= facts["seconds_above_noise"] < 0.3
    assert facts["loudest_second"] > 0.6


def test_evidence_sees_a_loud_effect() -> None:
    drives = [_clean("stribeck", 0.2, seed, speed_rad_s=10.0) for seed in (1, 2)]
    noisy = [measured(one, Instruments(), np.random.default_rng(3)) for one in drives]
    facts = evidence(D, drives[:1], noisy[:1], noisy[1], 5e-3)
    assert facts["seconds_above_noise"] > 0.8
