"""A remainder estimated with the model: its covariance, and what names are worth beside it."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.attribute.beside import LEAST, _Search
from eps_hil.diagnosis.balance.baseline import ALL, TIMING
from eps_hil.diagnosis.balance.discrepancy import Basis, Discrepancy, Whitening, _updated
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.probes import candidates
from eps_hil.diagnosis.balance.problem import Problem, knee
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model

pytestmark = pytest.mark.slow

STRIBECK = {"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 10.0}
DRAG = {"effect": "viscous_friction", "coefficient_nm_s_per_rad": 5e-4}


def test_a_residual_of_the_estimated_covariance_is_white_afterwards(problem: Problem) -> None:
    rng = np.random.default_rng(3)
    basis = Basis.of(problem)
    columns, group = basis.columns(problem)
    variance = np.where(np.arange(group.max() + 1) % 5 == 0, 30.0, 0.0)
    whitening = Whitening(basis, variance, 1.5)
    beside = problem.beside(whitening)
    weights = rng.standard_normal((len(group), 40)) * np.sqrt(variance[group])[:, None]
    drawn = columns @ weights + 1.5 * rng.standard_normal((len(columns), 40))
    energy = np.sum(beside.whitened(drawn) ** 2, axis=0) / (1.5**2 * len(columns))
    assert np.mean(np.sum(drawn**2, axis=0)) / (1.5**2 * len(columns)) > 3.0
    assert np.mean(energy) == pytest.approx(1.0, abs=0.02)


def test_the_variance_of_a_curve_and_of_the_noise_is_found(problem: Problem) -> None:
    rng = np.random.default_rng(4)
    problem.knee = 100.0
    told = Discrepancy(problem, np.zeros(len(problem.scale)))
    columns, group = told.basis.columns(problem)
    drawn = columns[:, group == 0] @ (5.0 * rng.standard_normal(int(np.sum(group == 0))))
    drawn += 2.0 * rng.standard_normal(len(drawn))
    found = told.evidence(drawn, np.zeros((len(drawn), 1)))
    assert found.sigma == pytest.approx(2.0, rel=0.05)
    assert 5.0 < found.variance[0] < 100.0
    assert np.count_nonzero(found.variance) <= 4


@pytest.mark.parametrize(("times", "beyond"), [(1.0, 0.0), (5.0, np.sqrt(21.0))])
def test_what_a_discrepancy_holds_is_no_error_in_the_equation_too(
    problem: Problem, times: float, beyond: float
) -> None:
    """Only what is left beside it is as large under every model; all else keeps its noise."""
    rng = np.random.default_rng(4)
    problem = replace(problem, beyond_nm=20.0 * problem.floor)
    found = fit(problem, [], own=ALL)
    problem.knee = 1e3
    search = _Search(problem, found)
    columns, group = search.discrepancy.basis.columns(problem)
    drawn = columns[:, group == 0] @ (30.0 * rng.standard_normal(int(np.sum(group == 0))))
    drawn += times * rng.standard_normal(len(drawn))
    assert np.std(drawn) > 10.0
    evidence = search.discrepancy.evidence(drawn, found.jacobian)
    without = set(catalogue()) - {"inertia", "stribeck"}
    pool = candidates(problem, [], problem.residual(problem.model), None, {}, without)
    again = search.weighed(evidence, pool)
    assert search.problem.beyond_nm == pytest.approx(beyond * problem.floor, rel=0.1)
    assert search.weighed(evidence, again) is again
    fresh = candidates(
        search.problem, [], search.problem.residual(problem.model), None, {}, without
    )
    assert len(fresh) == len(pool) > 1
    for one, new, old in zip(again, fresh, pool, strict=True):
        np.testing.assert_allclose(one.columns, new.columns)
        assert (one is old) == (one.effect.id == "stribeck")
    assert any(one is not old for one, old in zip(again, pool, strict=True))


def search_on(problem: Problem, entry: dict[str, Any], own: Mapping[str, float]) -> float:
    """What an entry is worth, some of the model's own numbers and a discrepancy free beside it."""
    found = fit(problem, [entry], own=own)
    problem.knee = knee(found.residual)
    search = _Search(problem, found)
    search.own = own
    return search.gain(search.model([entry]), 0)


def test_a_right_law_is_worth_more_than_the_curve_that_could_stand_for_it(problem: Problem) -> None:
    assert search_on(problem, STRIBECK, ALL) > LEAST


def test_a_law_that_stands_in_for_an_unknown_one_is_worth_nothing(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """A brake whose drag falls again at speed is no viscous one, whatever that gains."""
    brake = {other_rig.EDDY: 0.06, other_rig.EDDY_W: 20.0}
    recordings = record(brake, ("sweep", "weave"), seconds=12.0)
    problem = Problem([prepare(name, one) for name, one in recordings.items()], reference_model)
    bare = fit(problem, [], own=TIMING)
    assert bare.cost - fit(problem, [DRAG], own=TIMING).cost > 1000.0
    assert search_on(problem, DRAG, TIMING) < LEAST


def test_noise_alone_is_noise_and_nothing_is_said_on_the_terminal(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Where no curve is alive the linear algebra has nothing to do, and must not complain."""
    group = np.array([0, 0, 1])
    found = _updated(1e3 * np.eye(3), np.zeros(3), 1e3, 1e3, group, (np.zeros(2), 1.0))
    assert found.variance.tolist() == [0.0, 0.0]
    assert found.sigma == pytest.approx(1.0)
    assert capfd.readouterr() == ("", "")
