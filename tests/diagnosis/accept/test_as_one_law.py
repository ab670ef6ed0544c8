"""Names beside laws, and one law in their place."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from eps_hil.diagnosis.accept.as_one_law import as_one_law
from eps_hil.diagnosis.accept.beside_law import beside_law
from eps_hil.diagnosis.accept.holdout_support import holdout_support
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.attribute.select import select
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Model
from eps_hil.series import Series


@pytest.mark.slow
def test_a_name_that_no_law_holds_stays_beside_it(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """A spring beside an eddy-current brake that leaves many times as much."""
    plant = {other_rig.EDDY: 0.05, other_rig.EDDY_W: 30.0, other_rig.SPRING: 4e-4}
    fitted, kept = (
        [(prepare(name, one), one) for name, one in record(plant, programme, seed).items()]
        for programme, seed in ((("sweep", "weave"), 1), (("weave",), 2))
    )
    problem = Problem([one for one, _ in fitted], reference_model)
    judged = [Holdout(*one) for one in kept]
    selection = select(problem)
    findings = holdout_support(problem, selection, judged)
    found = beside_law(problem, ((selection, ()), (selection, findings)), judged, measured=True)
    assert found is not None
    assert found.findings
    alone = as_one_law(problem, found.selection, found.findings, found.remainder, judged)
    assert alone is None


@pytest.mark.slow
def test_names_beside_the_one_law_are_judged_with_that_law(
    pushed: tuple[Any, Model, dict[str, dict[str, Series]]],
) -> None:
    """What the hold-outs lose without a name is a fit of the same model, its law included."""
    _, model, made = pushed
    content = diagnose(model, made, {}).content
    named = [one["effect"] for one in content["findings"] if one["effect"] != "unknown"]
    assert named
    assert [one["effect"] for one in content["fit"]["placebo"]] == named
    for one in content["fit"]["placebo"]:
        assert one["left_over_n"]["without"] > one["left_over_n"]["with"]
