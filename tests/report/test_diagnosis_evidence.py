"""What a page is drawn from."""

from dataclasses import replace
from typing import Any

import numpy as np

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.physics.model import Model
from eps_hil.report.diagnosis_evidence import Evidence
from eps_hil.series import Series
from eps_hil.signals import CANONICAL


def test_a_term_is_taken_out_of_the_model_it_was_fitted_in(
    weave_truth: Any, reference_model: Model
) -> None:
    """Numbers of the model's own that have moved beside a law stay moved."""
    t_ns = np.round(weave_truth.time_s * 1e9).astype(np.int64)
    columns = {k: v for k, v in weave_truth.columns.items() if k in CANONICAL}
    series = {name: Series(t_ns, values) for name, values in columns.items()}
    problem = Problem([prepare("weave", series)], reference_model)
    moved = replace(reference_model, inertia_kg_m2=1.2 * reference_model.inertia_kg_m2)
    entry = {"effect": "unmodelled_spring", "stiffness_nm_per_rad": 1e-4}
    evidence = Evidence(problem, replace(moved, effects=(entry,)), [entry])
    (without,) = evidence.without_nm
    assert np.array_equal(without, problem.residual(moved) * problem.scale)
    assert not np.allclose(without, evidence.before_nm)
