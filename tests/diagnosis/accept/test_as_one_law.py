"""Names beside laws, and one law in their place."""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.accept.as_one_law import as_one_law
from eps_hil.diagnosis.accept.beside_law import beside_law
from eps_hil.diagnosis.accept.holdout_support import holdout_support
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.attribute.select import select
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Delays, Model
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
    closed_loop_rig: ModuleType, reference_model: Model
) -> None:
    """What the hold-outs lose without a name is a fit of the same model, its law included."""
    rig = closed_loop_rig.Rig(
        inertia=7.1e-5, level_pos=0.199, level_neg=0.235, drag=1.3e-4, grows=2.7e-4,
        stiffness=18.0, ratio=400.0, push=170.0, swing_rad=10.5, speed_loop=True,
    )  # fmt: skip
    friction = replace(
        reference_model.friction,
        offset_pos_nm=0.224, offset_neg_nm=0.264, load_pos_nm_per_n=1.7e-4,
        load_neg_nm_per_n=1.7e-4, viscous_pos_nm_s_per_rad=1.4e-4,
        viscous_neg_nm_s_per_rad=1.4e-4, sigma0_nm_per_rad=15.0, sigma1_nm_s_per_rad=0.0,
    )  # fmt: skip
    model = replace(reference_model, inertia_kg_m2=8.3e-5, rack_to_rotor_ratio_rad_per_m=400.0,
                    friction=friction, delays_s=Delays(), effects=())  # fmt: skip
    made = {}
    for seed in (1, 2, 3):
        columns = closed_loop_rig.record(rig, seed, 20.0, (1e-3, 0.03, 3e-4, 0.5))
        t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
        columns.pop("motor_angle_rad")
        made[str(seed)] = {name: Series(t_ns, one) for name, one in columns.items()}
    content = diagnose(model, made, {}).content
    named = [one["effect"] for one in content["findings"] if one["effect"] != "unknown"]
    assert named
    assert [one["effect"] for one in content["fit"]["placebo"]] == named
    for one in content["fit"]["placebo"]:
        assert one["left_over_n"]["without"] > one["left_over_n"]["with"]
