"""A law that is a number of the model's own that is off, in other words."""

from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any

import pytest

from eps_hil.diagnosis.accept.as_name import as_name
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.baseline import TIMING
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.probes import candidates
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.remainder.find import MOST_OF_IT, Remainder, Term, share_removed
from eps_hil.diagnosis.remainder.sight import Sight
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model

pytestmark = pytest.mark.slow

CONSIDERED = {"coulomb_level", "viscous_friction", "inertia"}


def named(
    plant: Mapping[int, float], law: Mapping[str, Any], record: Callable[..., Any], model: Model
) -> tuple[float, list[dict[str, Any]]]:
    """(share of the hold-outs' excess that a law takes off, entries in its place) of a rig."""
    fitted, kept = (
        [(prepare(name, one), one) for name, one in record(plant, programme, seed).items()]
        for programme, seed in ((("sweep", "weave"), 1), (("weave",), 2))
    )
    problem = Problem([one for one, _ in fitted], model)
    null = fit(problem, [], own=TIMING)
    without = set(catalogue()) - CONSIDERED
    pool = candidates(problem, [], null.residual, None, null.own, without)
    judged = [Holdout(*one) for one in kept]
    memory = ["none" for _ in law["inputs"]]
    entry = {"effect": "empirical", "form": "law", "how": "sum", "memory": memory, **law}
    with_law = problem.with_entries([entry])
    there = Problem([one.prepared for one in judged], model)
    share, ends = share_removed(Sight(there, model), there.residual(with_law))
    found = Remainder((Term(entry, None),), with_law, share, ends, null.residual, null.residual)
    told = as_name(problem, Selection(null, null, pool, problem, null), [], found, judged, {})
    return share, [] if told is None else [dict(one) for one in told[0].found.entries]


def test_a_torque_that_saturates_with_the_speed_is_a_friction_level(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    plant = {place: 1.6 * other_rig._BASE[place] for place in (other_rig.K0P, other_rig.K0N)}
    level = 0.6 * reference_model.friction.offset_pos_nm
    law = {"where": "rotor", "inputs": ["motor_speed_rad_s"], "shapes": ["saturating"],
           "size": level, "width_1": 0.5}  # fmt: skip
    share, (one,) = named(plant, law, record, reference_model)
    assert share > MOST_OF_IT
    assert one["effect"] == "coulomb_level"
    assert one["scale"] == pytest.approx(1.6, abs=0.03)


def test_a_law_that_no_number_does_as_well_as_stays(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """An eddy-current brake, most at 30 rad/s: neither a drag nor a level."""
    plant = {other_rig.EDDY: 0.05, other_rig.EDDY_W: 30.0}
    law = {"where": "rotor", "inputs": 2 * ["motor_speed_rad_s"], "shapes": ["linear", "rational"],
           "size": 0.1 / 30.0, "width_2": 30.0}  # fmt: skip
    share, entries = named(plant, law, record, reference_model)
    assert share > MOST_OF_IT
    assert entries == []
