"""The bristle's stiffness from full reversals: on LuGre's bristle, and on slip elements."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.balance.baseline import TIMING
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.direct.reversals import (
    Bristle,
    _asked,
    _power,
    _step,
    _Window,
    _windows,
    about_reversals,
    bristle,
    reversals_agree,
)
from eps_hil.physics.model import Model
from eps_hil.proof import manoeuvres, sensors
from eps_hil.proof.programmes import programme
from eps_hil.proof.truth import Floats
from eps_hil.proof.world import World
from eps_hil.series import Series

pytestmark = pytest.mark.slow

SIGMA0 = 4.5
"""Nm/rad, of the model file."""


def recorded(world: World, program: Floats, rng: np.random.Generator) -> dict[str, Series]:
    clean = sensors.reported(world.run(program), world.instruments)
    columns = sensors.measured(clean, world.instruments, rng)
    t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
    return {key: Series(t_ns, value) for key, value in columns.items()}


def world(simple: bool, ratio: float = 1.0, noise: float = 1.0) -> World:
    plain = World(simple=simple)
    return replace(
        plain,
        drive=plain.drive._replace(sigma0=SIGMA0 * ratio),
        instruments=replace(plain.instruments, noise=noise),
    )


def ready(rig: World, seed: int, seconds: float = 16.0) -> list[Prepared]:
    """A sweep and slow strokes."""
    rng = np.random.default_rng(seed)
    programs = manoeuvres.sweep(rng, seconds), manoeuvres.slow_reversals(rng, seconds)
    return [prepare(str(k), recorded(rig, one, rng)) for k, one in enumerate(programs)]


def asked(recordings: Sequence[Prepared], model: Model) -> tuple[Problem, Any, Bristle | None]:
    problem = Problem(recordings, model)
    found = fit(problem, [], own=dict(TIMING))
    return problem, found, bristle(problem, found)


@pytest.mark.parametrize("simple", [True, False])
@pytest.mark.parametrize("ratio", [0.7, 0.86, 1.0, 1.4])
def test_stiffness_and_form_are_seen(reference_model: Model, simple: bool, ratio: float) -> None:
    _, _, seen = asked(ready(world(simple, ratio), 3), reference_model)
    assert seen is not None
    assert seen.masing is not simple
    assert seen.log_ratio == pytest.approx(np.log(ratio), abs=0.045)
    assert abs(seen.log_ratio - np.log(ratio)) < 2.5 * seen.sigma
    assert (abs(seen.log_ratio) > 4.0 * seen.scatter) is (ratio != 1.0)
    assert seen.scatter < seen.sigma  # these are hardly driven under different loads
    assert not seen.off or ratio != 1.0
    assert seen.times_noise < 1.3


@pytest.mark.parametrize("power", [0.0, 0.3, -0.4, 1.0])
def test_what_goes_with_the_level_is_no_one_number(power: float) -> None:
    """Windows of an exact form, whose stiffness is the model's times the level to that power."""
    rng = np.random.default_rng(5)
    path = np.linspace(0.0, 3.0, 30)
    column = np.column_stack([path * np.exp(-path), np.cos(path)])
    levels = rng.normal(-2.5, 0.15, 60)
    windows = [
        _Window(-column[:, 0] * power * (one + 2.5) + 0.02 * rng.standard_normal(30), column, one)
        for one in levels
    ]
    assert _power(windows) == pytest.approx(min(abs(power), 1.0), abs=0.12)
    assert _power(windows) >= abs(power) - 0.02
    assert _power([replace(one, log_level=-2.5) for one in windows]) == 1.0


def test_noise_makes_no_bristle_stiffer(reference_model: Model) -> None:
    """Way that is lost at rest is not lost where the rotor only turns round."""
    for seed in (3, 4):
        _, _, seen = asked(ready(world(True, noise=3.0), seed), reference_model)
        assert seen is not None
        assert not seen.off
        assert abs(seen.log_ratio) < 0.06


def test_too_few_reversals_slow_samples_or_something_else_there_say_nothing(
    reference_model: Model,
) -> None:
    rig = world(True, 0.7)
    short = ready(rig, 3, seconds=4.0)[1:]
    assert asked(short, reference_model)[2] is None
    slow = [one.changed(interval_s=5e-3) for one in ready(rig, 3)]
    assert asked(slow, reference_model)[2] is None
    shaken = []
    for one in ready(rig, 3):
        torque = one.raw["motor_torque_nm"] + 0.02 * np.sin(90.0 * one.time_s)
        shaken.append(one.changed(raw={**one.raw, "motor_torque_nm": torque}))
    assert asked(shaken, reference_model)[2] is None


def test_beside_a_level_that_changes_at_the_turn_nothing_is_said(reference_model: Model) -> None:
    """Slip elements under a Stribeck effect reverse in neither form."""
    problem = Problem(ready(world(False, 0.7), 3), reference_model)
    stribeck = {"effect": "stribeck", "level_nm": 0.02, "speed_rad_s": 10.0}
    assert bristle(problem, fit(problem, [], own=dict(TIMING))) is not None
    assert bristle(problem, fit(problem, [stribeck], own=dict(TIMING))) is None


def test_holdouts_have_the_last_word(reference_model: Model) -> None:
    problem, found, seen = asked(ready(world(True, 0.45), 3), reference_model)
    assert seen is not None
    for ratio, agrees in ((0.45, True), (1.0, False), (1.3, False)):
        kept = [Holdout(one, {}) for one in ready(world(True, ratio), 5)]
        assert reversals_agree(seen, problem, found, kept) is agrees
    none = [Holdout(one, {}) for one in ready(world(True, 0.45), 5, seconds=3.0)[1:]]
    assert reversals_agree(seen, problem, found, none)  # it is beyond doubt without them
    faint = replace(seen, log_ratio=0.3 * seen.log_ratio)
    assert not reversals_agree(faint, problem, found, none)


@pytest.fixture(scope="module")
def diagnosed(reference_model: Model) -> Callable[[World], Any]:
    def at(rig: World) -> Any:
        rng = np.random.default_rng(8)
        made = [recorded(rig, one, rng) for one in programme("training", rng)]
        first, second, kept = made
        return diagnose(reference_model, {"a": first, "b": second}, {"kept": kept})

    return at


@pytest.mark.parametrize("simple", [True, False])
def test_a_softer_bristle_is_named_with_its_number(
    diagnosed: Callable[[World], Any], simple: bool
) -> None:
    result = diagnosed(world(simple, 0.85))
    (finding,) = result.content["findings"]
    assert finding["effect"] == "presliding_hysteresis"
    stated = finding["parameters"]["sigma0_nm_per_rad"]
    assert stated["value"] == pytest.approx(0.85 * SIGMA0, rel=0.05)
    assert stated["ci95"][0] < 0.85 * SIGMA0 < stated["ci95"][1]
    assert result.model.effects == (
        {"effect": "presliding_hysteresis", "sigma0_nm_per_rad": stated["value"]},
    )


@pytest.mark.parametrize("simple", [True, False])
def test_the_right_bristle_is_not_named(diagnosed: Callable[[World], Any], simple: bool) -> None:
    assert diagnosed(world(simple)).content["verdict"] == "no_mismatch"


@pytest.mark.parametrize("masing", [False, True])
@pytest.mark.parametrize("level_nm", [-0.1, -0.3, -10.0])
def test_friction_that_an_effect_takes_away_ends_nothing(
    reference_model: Model, level_nm: float, masing: bool
) -> None:
    """A level that a fit made nothing or less has no logarithm, and no length to go along."""
    place = {"level_nm": level_nm, "centre_m": 0.005, "width_m": 0.01}
    entry = {"effect": "position_dependent_friction", **place}
    model = replace(reference_model, effects=(entry,))
    recordings = ready(world(True, 0.7), 3)
    plain = _windows(recordings, reference_model, masing)
    windows = _windows(recordings, model, masing)
    assert len(windows) <= len(plain)
    assert (len(windows) == 0) is (level_nm == -10.0)
    if not windows:
        return
    assert np.all(np.isfinite([one.log_level for one in windows]))
    assert np.isfinite(_power(windows))
    assert np.all(np.isfinite(_step(windows)))
    assert np.all(np.isfinite(about_reversals(recordings, model, masing)[1]))


def test_a_recording_without_friction_or_samples_ends_nothing(reference_model: Model) -> None:
    place = {"level_nm": -10.0, "centre_m": 0.0, "width_m": 1.0}
    smooth = replace(reference_model, effects=({"effect": "position_dependent_friction", **place},))
    assert _asked(ready(world(True, 0.7), 3), smooth, masing=False) is None
    assert _asked([], reference_model, masing=False) is None
