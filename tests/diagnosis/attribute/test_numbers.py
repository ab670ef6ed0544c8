"""Which of the model's own numbers are off."""

import numpy as np
import numpy.typing as npt
import pytest

from eps_hil.diagnosis.attribute.numbers import _column
from eps_hil.diagnosis.balance.baseline import OFFSET
from eps_hil.diagnosis.balance.probes import candidates
from eps_hil.diagnosis.balance.problem import Problem

Floats = npt.NDArray[np.float64]

pytestmark = pytest.mark.slow


def test_both_levels_by_one_factor_are_each_by_its_own(problem: Problem) -> None:
    """Also where a refit bent one up and the other down, with a constant against the two.

    Against the residual itself, on the model's own numbers.
    """
    bent = Problem(problem.recordings, problem.model)
    bent.at = {"offset_pos_nm": 1.0, "offset_neg_nm": -1.0, OFFSET: 1.0}
    columns = {}
    for name, one in (("own", problem), ("bent", bent)):
        pool = candidates(one, [], one.residual(one.with_entries([], one.at)), None, one.at)
        (level,) = (each for each in pool if each.effect.id == "coulomb_level")
        columns[name] = level.columns[problem.sliding, 0]
        columns["found in " + name] = _column(one, level)[problem.sliding]
    assert off(columns["found in own"], columns["own"]) < 0.02
    assert off(columns["found in bent"], columns["own"]) < 0.02
    assert off(columns["bent"], columns["own"]) > 0.1  # what a refit that bent would make of it
    more, less = (
        problem.residual(problem.with_entries([{"effect": "coulomb_level", "scale": scale}], {}))
        for scale in (1.01, 0.99)
    )
    taken_off = ((less - more) / 0.02)[problem.sliding]
    assert off(columns["found in bent"], taken_off) < 0.02


def off(one: Floats, other: Floats) -> float:
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))
