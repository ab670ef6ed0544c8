"""The last refinement: free runs and balance together, judged on recordings kept from the fit."""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.accept.by_simulation import refined_by_simulation
from eps_hil.diagnosis.accept.free_run import free_run, memories_at, simulated
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.physics.model import Model

BRAKE = {
    "effect": "empirical", "form": "law", "where": "rotor", "how": "sum",
    "inputs": ["motor_speed_rad_s", "motor_speed_rad_s"], "memory": ["none", "none"],
    "shapes": ["linear", "rational"], "width_2": 30.0,
}  # fmt: skip


def braked(model: Model, size: float) -> Model:
    return replace(model, effects=({**BRAKE, "size": size},))


def rig(record: Callable[..., Any], other_rig: ModuleType, size: float, seed: int) -> list[Holdout]:
    plant = {other_rig.EDDY: size, other_rig.EDDY_W: 30.0}
    made = record(plant, ("weave",), seed, seconds=8.0)
    return [Holdout(prepare(name, series), series) for name, series in made.items()]


@pytest.mark.slow
def test_a_size_and_a_constant_that_are_off_come_nearer(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    fitted, judged = (rig(record, other_rig, 0.05, seed) for seed in (1, 2))
    right = braked(reference_model, 2.0 * 0.05 / 30.0)
    friction = reference_model.friction
    off = replace(friction, offset_pos_nm=friction.offset_pos_nm + 0.01)
    wrong = replace(braked(reference_model, 1.8 * 0.05 / 30.0), friction=off)
    problem = Problem([one.prepared for one in fitted], reference_model)
    found = refined_by_simulation(problem, wrong, judged, own=True)
    before, after, best = (free_run(judged, one)["angle_rmse_rad"] for one in (wrong, found, right))
    assert before is not None
    assert after is not None
    assert best is not None
    assert best < after < 0.5 * before
    assert found.effects[0]["size"] > wrong.effects[0]["size"]
    assert found.friction.offset_pos_nm < wrong.friction.offset_pos_nm
    kept = problem.over([one.prepared for one in judged])
    left = [np.sum(kept.residual(one)[kept.sliding] ** 2) for one in (wrong, found)]
    assert left[1] < left[0]


def test_a_model_that_leaves_nothing_but_noise_stays_as_it_is(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    fitted = rig(record, other_rig, 0.0, 3)
    problem = Problem([one.prepared for one in fitted], reference_model)
    assert refined_by_simulation(problem, reference_model, fitted, own=True) is reference_model


def test_what_only_the_fitted_recordings_want_is_left_out(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """The hold-out is of a rig that brakes less: it has nothing to gain by a stronger brake."""
    fitted, judged = (rig(record, other_rig, size, 4) for size in (0.08, 0.05))
    given = braked(reference_model, 2.0 * 0.05 / 30.0)
    problem = Problem([one.prepared for one in fitted], reference_model)
    assert refined_by_simulation(problem, given, judged, own=False) is given


def test_a_piece_begins_with_what_a_law_remembers_there(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """A drag that follows the heat of motion: from any sample on, a piece is the whole run's."""
    law = {**BRAKE, "size": 2e-5, "form": "dynamic", "memory": ["none", "heat"], "memory_2": 5.0,
           "shapes": ["linear", "linear"]}  # fmt: skip
    del law["width_2"]
    model = replace(reference_model, effects=(law,))
    (one,) = rig(record, other_rig, 0.05, 5)
    motion = one.prepared.motion(model)
    whole = simulated(motion, model, slice(0, None))
    ran = motion._replace(speed_rad_s=whole.speed_rad_s, angle_rad=whole.angle_rad)
    first = next(k for k in range(5000, 6000) if abs(whole.speed_rad_s[k]) > 20.0)
    *_, memory = memories_at(ran, model, [first - 2000, first])
    piece = simulated(ran, model, slice(first, first + 500), memory).speed_rad_s
    cold = replace(model, effects=())
    off = simulated(ran, cold, slice(first, first + 500)).speed_rad_s - piece
    error = piece - whole.speed_rad_s[first : first + 500]
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean(off**2))
