"""What has no name, beside numbers of the model's own that are off."""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.accept.nameless import _in_its_place, nameless
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.baseline import TIMING
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.remainder.find import Remainder, Term
from eps_hil.diagnosis.remainder.grammar import Law
from eps_hil.physics.model import Model

LAW = Law("rotor", "sum", ())


@pytest.mark.parametrize(
    ("laws_before", "laws_after", "gone", "ends", "stands"),
    [
        ((None, None, LAW), (None, LAW), -0.04, (-0.17, 0.11), True),  # one curve less, as good
        ((None, None, LAW), (None, LAW), -0.2, (-0.3, -0.1), False),  # clearly worse
        ((None, LAW), (None, LAW), 0.03, (-0.1, 0.1), False),  # as many curves, as good
        ((None, LAW), (None, None), 0.1, (0.05, 0.2), True),  # better
        ((None, LAW), (None, None), 0.1, (-0.01, 0.2), False),  # not clear of zero
        (None, (LAW,), 0.03, (0.01, 0.05), False),
    ],
)
def test_refitted_numbers_stand_if_they_are_better_or_need_fewer_curves(
    reference_model: Model,
    laws_before: tuple[Law | None, ...] | None,
    laws_after: tuple[Law | None, ...],
    gone: float,
    ends: tuple[float, float],
    stands: bool,
) -> None:
    def found(laws: tuple[Law | None, ...]) -> Remainder:
        none = np.zeros(0)
        terms = tuple(Term({}, law) for law in laws)
        return Remainder(terms, reference_model, 0.8, (0.7, 0.9), none, none)

    best = None if laws_before is None else found(laws_before)
    assert _in_its_place(best, found(laws_after), gone, ends) is stands


@pytest.mark.slow
def test_numbers_that_are_off_are_fitted_beside_a_law(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """An eddy-current brake on a rig whose inertia and levels the model file has wrong."""
    plant = {other_rig.EDDY: 0.05, other_rig.EDDY_W: 30.0}
    friction = replace(
        reference_model.friction,
        offset_pos_nm=1.4 * reference_model.friction.offset_pos_nm,
        offset_neg_nm=0.8 * reference_model.friction.offset_neg_nm,
    )
    wrong = replace(reference_model, inertia_kg_m2=2.4e-4, friction=friction)
    fitted, kept = (
        [(prepare(name, one), one) for name, one in record(plant, programme, seed).items()]
        for programme, seed in ((("sweep", "weave"), 1), (("weave",), 2))
    )
    problem = Problem([one for one, _ in fitted], wrong)
    null = fit(problem, [], own=TIMING)
    selection = Selection(null, null, [], problem, null)
    found, named = nameless(problem, selection, [], [Holdout(*one) for one in kept], {})
    assert named == []
    assert found is not None
    assert found.refitted
    assert found.share > 0.95
    assert found.model.inertia_kg_m2 == pytest.approx(2.0e-4, rel=0.05)
    assert any("motor_speed_rad_s" in name for name in found.entries[0]["inputs"])
