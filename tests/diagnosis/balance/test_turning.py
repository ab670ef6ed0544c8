"""A stiffer bristle is judged by the way over which friction turns round, not by its stiffness."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance.fit import BRISTLE, Fit
from eps_hil.diagnosis.balance.turning import ends_of, half_widths_off, in_words, stiffer
from eps_hil.diagnosis.data.size import ORDINARY
from eps_hil.physics.model import Model

NAME = "sigma0_nm_per_rad"


def stiffness(value: float) -> dict[str, Any]:
    return {"effect": BRISTLE, NAME: value}


@pytest.fixture
def problem(reference_model: Model) -> Any:
    """All that is asked of a problem: the model (σ0 = 4.5), the size, and costs of residuals."""
    return SimpleNamespace(
        model=reference_model,
        size=ORDINARY,
        cost=lambda residual: float(residual @ residual),
        with_entries=lambda entries, own: entries,
    )


def test_what_is_clear_in_the_way_is_clear_however_wide_the_stiffness_is(problem: Any) -> None:
    way = (1 / 4.5 - 1 / 45.0) / (30.0 / 45.0**2)
    assert half_widths_off(stiffness(45.0), 30.0, problem) == pytest.approx(way)
    assert (45.0 - 4.5) / 30.0 < 2.5 < way


def test_a_softer_bristle_and_other_effects_are_judged_as_they_are_fitted(problem: Any) -> None:
    assert half_widths_off(stiffness(2.5), 0.5, problem) == pytest.approx(4.0)
    entry = {"effect": "inertia", "scale": 1.1}
    assert half_widths_off(entry, 0.05, problem) == pytest.approx(2.0)
    assert stiffer(entry, problem) == 1.0
    assert half_widths_off(entry, 0.0, problem) == np.inf


def test_the_interval_is_the_way_s_and_open_where_there_may_be_none(problem: Any) -> None:
    assert ends_of(stiffness(45.0), NAME, 30.0, problem) == pytest.approx([27.0, 135.0])
    assert ends_of(stiffness(45.0), NAME, 60.0, problem) == pytest.approx([19.3, 500.0], rel=0.01)
    assert ends_of(stiffness(3.0), NAME, 1.0, problem) == [2.0, 4.0]


@pytest.mark.parametrize(("left", "none"), [(0.1, True), (0.01, False)])
def test_the_summary_says_whether_no_presliding_does_as_well(
    problem: Any, left: float, none: bool
) -> None:
    def fitted(residual: float, value: float) -> Fit:
        return Fit((stiffness(value),), np.array([residual]), (), np.zeros((1, 0)))

    problem.residual = lambda entries: np.array([0.1 if left == 0.1 else 0.5])
    said = in_words(problem, fitted(left, 45.0), 0, fitted(1.0, 45.0), 0.97)
    assert "over 10 % of the way" in said
    assert ("No presliding at all" in said) is none
    assert in_words(problem, fitted(left, 3.0), 0, fitted(1.0, 3.0), 0.97) == ""
    assert "No presliding" not in in_words(problem, fitted(left, 45.0), 0, None, 0.97)
