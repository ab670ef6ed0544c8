"""Which of the model's own numbers are off."""

import numpy as np
import pytest

from eps_hil.diagnosis.baseline import OFFSET
from eps_hil.diagnosis.numbers import _column
from eps_hil.diagnosis.probes import candidates
from eps_hil.diagnosis.problem import Problem

pytestmark = pytest.mark.slow


def test_both_levels_by_one_factor_are_each_by_its_own(problem: Problem) -> None:
    """Also where a refit bent one up and the other down, with a constant against the two.

    Against the residual itself, on the model's own numbers.
    """
    model = problem.model
    bent = Problem(problem.recordings, model)
    bent.at = {"offset_pos_nm": 1.0, "offset_neg_nm": -1.0, OFFSET: 1.0}
    pool = candidates(bent, [], bent.residual(bent.with_entries([], bent.at)), None, bent.at)
    (level,) = (one for one in pool if one.effect.id == "coulomb_level")
    more, less = (
        problem.residual(problem.with_entries([{"effect": "coulomb_level", "scale": scale}], {}))
        for scale in (1.01, 0.99)
    )
    true = ((more - less) / 0.02)[problem.sliding]
    found = _column(bent, level)[problem.sliding]
    off = np.linalg.norm(found - true) / np.linalg.norm(true)
    assert off < 0.02
    assert np.linalg.norm(level.columns[problem.sliding, 0] - true) / np.linalg.norm(true) > 0.1
