"""The comparison's own plant, a stranger to the package's physics, and the tables it prints."""

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from eps_hil.adaptation.injection_settings import InjectionSettings
from eps_hil.adaptation.torque_injection import TorqueInjection

SCRIPTS = Path(__file__).parents[2] / "scripts"
STRANGER = "Maxwell slip"


@pytest.fixture(scope="module")
def study() -> Any:
    """``scripts/adaptation_study.py`` as a module."""
    sys.path.insert(0, str(SCRIPTS))
    try:
        import adaptation_study  # type: ignore[import-not-found]
    finally:
        sys.path.remove(str(SCRIPTS))
    assert isinstance(adaptation_study, ModuleType)
    return adaptation_study


@pytest.mark.slow
@pytest.mark.parametrize("hands", [False, True])
@pytest.mark.parametrize("factors", [(0.6, 1.4), (1.4, 0.6)])
def test_torque_injection_on_friction_of_another_form(
    study: Any, hands: bool, factors: tuple[float, float]
) -> None:
    """Maxwell-slip elements and another integrator: k0± within 3 % all the same."""
    true = study.scaled(study.NOMINAL, *factors)
    course = study.parked("parked", 40.0, hands=hands)
    injection = TorqueInjection(InjectionSettings(repetitions=3), study.NOMINAL)
    study.inject(STRANGER, true, course, injection, seed=1)
    result = injection.result
    assert result is not None
    assert result.accepted
    found = (result.positive.offset_nm, result.negative.offset_nm)
    assert max(abs(one) for one in study.errors(true, found)) < 0.03


@pytest.mark.slow
def test_a_tyre_that_pushes_back_is_noticed(study: Any) -> None:
    course = study.parked("parked", 40.0, hands=False, tyre=46e3)
    outcome = study.torque_injection(STRANGER, study.NOMINAL, course, 2)
    assert not outcome.claimed
    assert "the rack force was not zero" in outcome.note


@pytest.mark.slow
def test_error_injection_and_reversals_on_friction_of_another_form(study: Any) -> None:
    true = study.scaled(study.NOMINAL, 0.7, 1.3)
    for course, method in (
        (study.steered("near centre", 12.0, 1), study.EI),
        (study.driven("driving", 20.0, 1), study.RC),
    ):
        rows = study.record(STRANGER, true, course, 1)
        ((outcome, track),) = study.listeners(STRANGER, true, course, rows, (method,))
        assert outcome.claimed
        assert outcome.worst < 0.03
        assert abs(track[0][1]) > 0.3


def test_the_table_counts_what_was_claimed(study: Any) -> None:
    claimed = study.Outcome("driving", study.RA, STRANGER, 0.2, -0.1, 0.01, True, 6.0)
    silent = study.Outcome("driving", study.RA, STRANGER, 0.9, 0.9, 0.9, False, float("nan"))
    wrong = study.Outcome("driving", study.RA, STRANGER, 0.3, 0.3, 0.3, True, float("nan"))
    head, _, row = study.table([claimed, silent, wrong])
    assert "| driving | reversal | 3 | 2 |" in row
    assert row.endswith("| 30.0 | – | 1 |")
    assert head.count("|") == row.count("|")
