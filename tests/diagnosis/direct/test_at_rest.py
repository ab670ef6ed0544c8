"""What rest and turning leave is weighed against what the sensors make of a right model."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.accept.proof_of_fit import Holdout, more_than_noise
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.direct.at_rest import right, turns_otherwise
from eps_hil.diagnosis.verdict.spoken import all_clear
from eps_hil.physics.model import Model


def said(
    record: Callable[..., Any], model: Model, plant: dict[int, float], noise: float = 1.0
) -> list[str]:
    fitted, kept = (
        [(prepare(name, one), one) for name, one in made.items()]
        for made in (
            record(plant, ("weave", "slow"), noise=noise),
            record(plant, ("weave", "slow"), seed=2, noise=noise),
        )
    )
    problem = Problem([one for one, _ in fitted], model)
    return turns_otherwise(problem, [Holdout(*one) for one in kept], model)


@pytest.mark.parametrize("noise", [0.1, 1.0, 3.0])
def test_a_right_model_turns_as_the_rig(
    record: Callable[..., Any], reference_model: Model, noise: float
) -> None:
    assert said(record, reference_model, {}, noise) == []


def test_slip_elements_are_more_than_sensor_noise(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """A generalised Maxwell-slip rig leaves no more than noise of what slides, and much of this."""
    (one,) = said(record, reference_model, {other_rig.SLIP: 1.0})
    assert "and nothing that was found explains it" in one
    assert more_than_noise([one])
    assert "sensor noise" not in all_clear([one]).replace("more than sensor noise", "")
    assert "what differs is sensor noise" in all_clear([])


def test_what_a_right_model_leaves_is_tried(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """Of a rig of another presliding, sliding leaves as much as before and turning hardly more."""
    ((name, series),) = record({other_rig.SLIP: 1.0}, ("weave",)).items()
    one = prepare(name, series)
    sliding = Problem([one], reference_model).sliding

    def left_nm(these: Prepared, where: Any) -> float:
        return float(np.sqrt(np.mean(these.left_over(reference_model)[where] ** 2)))

    tried = right(one, reference_model)
    assert left_nm(tried, sliding) == pytest.approx(one.floor_nm(reference_model), rel=0.2)
    assert left_nm(tried, ~sliding) < 0.3 * left_nm(one, ~sliding)
