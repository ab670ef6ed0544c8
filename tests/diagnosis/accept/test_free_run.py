"""Whole hold-outs simulated from their first state."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from eps_hil.diagnosis.accept.free_run import free_run
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.physics.model import Model


@pytest.fixture(scope="module")
def holdout(record: Callable[..., Any]) -> Holdout:
    ((name, series),) = record({}, ("sweep",), seconds=4.0).items()
    return Holdout(prepare(name, series), series)


def test_a_worse_model_runs_further_off(holdout: Holdout, reference_model: Model) -> None:
    wrong = replace(reference_model, inertia_kg_m2=2.0 * reference_model.inertia_kg_m2)
    right, off = (free_run([holdout], one) for one in (reference_model, wrong))
    for name in ("speed_rmse_rad_s", "angle_rmse_rad"):
        near, far = right[name], off[name]
        assert near is not None
        assert far is not None
        assert near < 0.5 * far


def test_a_run_that_does_not_exist_is_null(reference_model: Model) -> None:
    assert free_run([], reference_model) == {"speed_rmse_rad_s": None, "angle_rmse_rad": None}
