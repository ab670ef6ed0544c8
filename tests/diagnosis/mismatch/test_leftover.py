"""What is left and has no name: here a motor torque that is late by a part of a sample."""

import numpy as np
import pytest

from eps_hil.diagnosis.balance.baseline import HOLD_S, TIMING
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.mismatch.leftover import how_held

STRIBECK = {"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 10.0}


def later(problem: Problem, seconds: float) -> Problem:
    """The motor's torque acts ``seconds`` later than reported: the report is early."""
    moved = []
    for one in problem.recordings:
        torque = np.interp(one.time_s + seconds, one.time_s, one.raw["motor_torque_nm"])
        moved.append(one.changed(raw={**one.raw, "motor_torque_nm": torque}))
    return Problem(moved, problem.model)


@pytest.fixture(scope="module")
def in_time(problem: Problem) -> Problem:
    """These recordings' torque is held for a sample: without what that makes it late."""
    own = fit(problem, [STRIBECK], own=dict(TIMING)).own
    return later(problem, -HOLD_S * next(iter(own.values())))


def said(problem: Problem) -> list[str]:
    return how_held(problem, fit(problem, [STRIBECK], own=dict(TIMING)))


@pytest.mark.parametrize(("seconds", "word"), [(5e-4, "later"), (-5e-4, "earlier")])
def test_a_part_of_a_sample_is_told(in_time: Problem, seconds: float, word: str) -> None:
    (sentence,) = said(later(in_time, seconds))
    told_ms = float(sentence.partition("acts ")[2].partition(" ms")[0])
    assert f" ms {word} than the model file says" in sentence
    assert told_ms == pytest.approx(abs(1e3 * seconds), abs=0.06)


def test_what_is_in_time_is_not_told(in_time: Problem) -> None:
    assert said(in_time) == []
