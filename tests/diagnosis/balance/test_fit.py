"""Levenberg and Marquardt's steps where there is nothing to step from."""

import numpy as np
import numpy.typing as npt
import pytest

from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.physics.model import Model


def test_a_start_without_a_finite_residual_costs_more_than_any(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As friction that is taken off twice: the trial is no better than what there is."""
    residual, at = Problem.residual, problem.knee

    def seen(self: Problem, model: Model) -> npt.NDArray[np.float64]:
        found = residual(self, model)
        return found * np.nan if model.effects else found

    monkeypatch.setattr(Problem, "residual", seen)
    entry = {"effect": "coulomb_level", "scale": 0.05}
    found = fit(problem, [entry], own={"inertia": 0.1})
    assert found.cost == np.inf
    assert list(found.entries) == [entry]
    assert found.jacobian.shape == (len(found.residual), 2)
    assert problem.knee == at
    assert np.isfinite(fit(problem, []).cost)
