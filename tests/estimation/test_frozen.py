"""Torques that repeat themselves: late, at rest, or of a sender that sends a value again."""

from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.frozen import torques_untold
from eps_hil.estimation.plausibility import judge_sample, limits_of
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.watch import new_watch
from eps_hil.physics.model import Model


def frozen_at(model: Model, torque: Any, sensor: Any) -> int:
    """Sample at which either torque of a resting rotor is first told as frozen; -1: never."""
    watch, limits = new_watch(), limits_of(model, EstimatorSettings(), True)
    for k in range(len(torque)):
        judge_sample(watch, limits, 0, k * 10**6, torque[k])
        judge_sample(watch, limits, 1, k * 10**6, sensor[k])
        if np.any(watch["frozen"][0, :2]):
            return k
    return -1


@pytest.mark.parametrize("seed", range(5))
def test_torques_that_repeat_themselves_at_rest_are_late(reference_model: Model, seed: int) -> None:
    """Old values under new counters begin with one value again and again: ten are enough."""
    rng = np.random.default_rng(seed)
    torque, sensor = 0.3 + 5e-3 * rng.standard_normal((2, 1000))
    torque[600:611], sensor[600:611] = torque[600], sensor[600]
    assert 604 < frozen_at(reference_model, torque, sensor) <= 610


@pytest.mark.parametrize("both", [True, False])
def test_two_torques_that_repeat_themselves_at_once_are_late_by_less(
    reference_model: Model, both: bool
) -> None:
    """Five equal samples of one noisy torque may be an accident, of both at once they are not."""
    torque, sensor = 0.3 + 5e-3 * np.random.default_rng(7).standard_normal((2, 1000))
    torque[600:606] = torque[600]
    if both:
        sensor[600:606] = sensor[600]
    assert frozen_at(reference_model, torque, sensor) == (605 if both else -1)


def test_a_sender_that_now_and_then_sends_both_torques_again_is_believed(
    reference_model: Model,
) -> None:
    """An ECU whose torques are new every fourth millisecond, and late by one more at times."""
    torque, sensor = 0.3 + 5e-3 * np.random.default_rng(7).standard_normal((2, 4000))
    place = np.arange(4000) // 4 * 4
    for k in range(400, 4000, 200):
        place[k : k + 6] = k
    assert frozen_at(reference_model, torque[place], sensor[place]) == -1


def test_torques_without_noise_may_rest(reference_model: Model) -> None:
    """A creeping load and a coarse signal: each change goes the same way as the one before."""
    creep = np.round(np.cumsum(np.r_[np.full(400, 1e-3), np.zeros(600)]), 2)
    assert frozen_at(reference_model, creep + 0.3, creep + 0.5) == -1


def test_noise_that_ends_as_the_rotor_begins_to_move_is_a_frozen_torque(
    reference_model: Model,
) -> None:
    """What moving samples look like is not learnt yet; what noise is, is known from the rest."""
    limits = limits_of(reference_model, EstimatorSettings(), angle_seen=True)
    watch, rng = new_watch(), np.random.default_rng(2)
    for k in range(400):
        value = 0.1 + 4e-3 * rng.standard_normal() if k < 380 else 0.1
        watch[0].moving = int(k >= 370)
        judge_sample(watch, limits, 0, (k + 1) * 10**6, value)
        assert bool(watch[0].frozen[0]) == (k >= 390) or 380 < k < 390


def test_a_short_rest_says_little_of_how_often_noise_repeats_itself(
    reference_model: Model,
) -> None:
    """Coarse noise of which no two neighbours were equal in 40 ms of rest: it had stood for 3 %."""
    limits = limits_of(reference_model, EstimatorSettings(), angle_seen=True)
    watch, rng = new_watch(), np.random.default_rng(3)
    rest = 2e-3 * np.array([1, -1, 0, 2, -2] * 8)
    noise = 2e-3 * np.round(1.5 * rng.standard_normal(600))  # 18 % of the neighbours are equal
    noise[500:508], noise[580:596] = noise[500], noise[580]
    said = []
    for k, value in enumerate(np.r_[rest, noise]):
        watch[0].moving = int(k >= len(rest))
        judge_sample(watch, limits, 0, (k + 1) * 10**6, 0.1 + value)
        said.append(bool(watch[0].frozen[0]))
    assert not any(said[: len(rest) + 580])
    assert any(said[len(rest) + 580 : len(rest) + 596])


def frozen_ms(model: Model, sensor: Any) -> int:
    """For how many samples the torsion bar of a turning rotor is told as frozen, or as untold."""
    watch, limits, found = new_watch(), limits_of(model, EstimatorSettings(), True), 0
    watch[0].moving = 1
    for k, value in enumerate(sensor):
        judge_sample(watch, limits, 1, (k + 1) * 10**6, value)
        found += bool(watch[0].frozen[1]) or bool(torques_untold(watch[0]))
    return found


def coarse(zero_nm: float, noise_nm: float, rows: int = 10_000) -> Any:
    """A torsion bar of steps of 0.02 Nm, hands off."""
    rng = np.random.default_rng(3)
    return 0.02 * np.round((zero_nm + noise_nm * rng.standard_normal(rows)) / 0.02)


def test_a_quiet_torque_whose_zero_is_a_step_off_is_believed(reference_model: Model) -> None:
    """Hands off, zero one step off: it was frozen for as long as the rotor moved. The first time
    that it changes by a step shows it to be alive, and quiet."""
    sensor = np.r_[np.full(300, 0.02), coarse(0.021, 3e-3)]
    first = 300 + int(np.argmax(sensor[300:] != 0.02))
    assert frozen_ms(reference_model, sensor) <= first


@pytest.mark.parametrize(
    ("sensor", "told"),
    [
        (np.r_[coarse(0.021, 0.0, 5000)], 4000),  # nothing shows that it is alive
        (np.r_[coarse(0.021, 3e-3, 5000), np.full(5000, 0.3)], 4000),  # stuck where a hand pulls
        (np.r_[coarse(0.021, 0.05, 5000), np.full(5000, 0.02)], 4000),  # noise that ended
        (np.r_[0.02 + 1e-3 * coarse(0.0, 0.1, 5000), np.full(5000, 0.021)], 4000),  # finer steps
    ],
)
def test_a_torque_that_is_stuck_is_told_still(
    reference_model: Model, sensor: Any, told: int
) -> None:
    assert frozen_ms(reference_model, sensor) > told
