"""The whole diagnosis on rigs of the truth plant that hide what no name stands for."""

from collections.abc import Mapping

import numpy as np
import pytest

from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.model import Model
from eps_hil.proof.cases import PARAMETERS, make
from eps_hil.proof.plans import Plan
from eps_hil.proof.truth import Floats
from eps_hil.series import Series


def diagnosed(model: Model, name: str, size: float = 3.0, seed: int = 11) -> Diagnosis:
    return of_plan(model, Plan("nameless", seed, ((name, size),)))


def of_plan(model: Model, plan: Plan) -> Diagnosis:
    case = make(plan)
    recordings = {one: series_of(columns) for one, columns in case.recordings.items()}
    kept = {"holdout": recordings.pop("holdout")}
    return diagnose(model, recordings, kept)


def series_of(columns: Mapping[str, Floats]) -> dict[str, Series]:
    t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
    return {name: Series(t_ns, values) for name, values in columns.items() if name != "time_s"}


@pytest.mark.slow
def test_a_loss_that_looks_like_a_ratio_is_modelled(reference_model: Model) -> None:
    """Dead time of an inverter: the balance wants another ratio, which is measured to be right."""
    content = diagnosed(reference_model, "alien_dead_time").content
    (found,) = content["findings"]
    assert found["resembles"][0]["what"] == "inverter dead time"
    assert found["where"][0]["signal"] == "motor_torque_nm"
    before, after = (
        content["fit"]["holdout"][one]["torque_nrmse"] for one in ("baseline", "augmented")
    )
    assert after < 0.2 * before
    assert found["model"]["holdout_share_removed"] == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
def test_a_loss_where_the_load_drives_is_one_law_and_no_friction(reference_model: Model) -> None:
    """|F| where the load drives: half of it is friction that grows with the load, half a gain."""
    told = diagnosed(reference_model, "late_nut_loss", seed=12)
    (found,) = told.content["findings"]
    assert found["resembles"][0]["what"] == "mesh efficiency, driving against driven"
    assert found["where"][0]["signal"] == "rack_force_n"
    assert found["model"]["holdout_share_removed"] == pytest.approx(1.0, abs=0.03)
    assert [one["effect"] for one in told.model.effects] == ["empirical"]


@pytest.mark.slow
def test_friction_that_follows_the_load_late_is_found_beside_what_follows_at_once(
    reference_model: Model,
) -> None:
    """Only a part of it is late: the law and the model's own load friction are found together."""
    (found,) = diagnosed(reference_model, "alien_load_memory", seed=84).content["findings"]
    assert found["resembles"][0]["what"] == "friction that follows the load late"
    assert found["where"][0]["signal"] == "rack_force_n"
    assert found["model"]["holdout_share_removed"] == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_numbers_of_the_file_that_are_a_little_off_are_named_and_no_law(
    reference_model: Model,
) -> None:
    """Small ones gain no more than the luckiest placebo beside them, and are true."""
    content = of_plan(reference_model, Plan("decoys", 467, (), decoy="parameters_off")).content
    names = {one["effect"] for one in content["findings"]}
    assert content["verdict"] == "explained"
    assert "unknown" not in names
    assert {"inertia", "load_dependent_friction"} <= names <= set(PARAMETERS)


@pytest.mark.slow
def test_a_curve_that_a_pattern_hid_is_found_beside_its_law(reference_model: Model) -> None:
    """A ripple that grows with the load makes a first curve of many bends; the curve beside the
    ripple's law was not looked for any more once the first was refused."""
    plan = Plan("beside", 502, (("alien_load_ripple", 3.0), ("position_torque", 0.6)))
    content = of_plan(reference_model, plan).content
    assert [one["effect"] for one in content["findings"]] == ["position_torque", "unknown"]
