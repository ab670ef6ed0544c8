"""A place that is only passed at one time is not told from that time."""

from collections.abc import Callable, Mapping
from typing import Any

import pytest

from eps_hil.diagnosis.accept.other_times import Place, gone, places_in_time
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.balance.baseline import ALL
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.model import Model

pytestmark = pytest.mark.slow

NAME = "position_dependent_friction"
THERE = {"effect": NAME, "level_nm": 0.02, "centre_m": 0.034, "width_m": 0.006}
SECONDS = 36.0

Record = Callable[..., Mapping[str, Mapping[str, Any]]]


def worn(rig: Any) -> dict[int, float]:
    return {rig.POSF: 0.03, rig.POSC: 0.035, rig.POSW: 0.006}


def warming(rig: Any) -> dict[int, float]:
    return {rig.WARM: 0.6, rig.WARM_T: 6.0}


def told(
    record: Record,
    model: Model,
    plant: Mapping[int, float],
    fitted: str,
    kept: str,
    start: Mapping[str, float] | None = None,
) -> Place:
    made, spared = (
        [prepare(name, one) for name, one in record(plant, (way,), seed, seconds=SECONDS).items()]
        for way, seed in ((fitted, 1), (kept, 2))
    )
    problem = Problem(made, model)
    found = fit(problem, [], own=ALL)
    found = fit(problem, [{**THERE, **(start or {})}], 0 if start else 10, found.own)
    (place,) = places_in_time(problem, found, [0], [Holdout(one, {}) for one in spared]).values()
    return place


@pytest.mark.parametrize(
    ("fitted", "kept", "expected"),
    [
        ("once", "once", Place.OPEN),
        ("twice", "twice", Place.STAYS),
        ("once", "twice", Place.STAYS),
    ],
)
def test_a_place_has_to_be_passed_at_another_time(
    record: Record, reference_model: Model, other_rig: Any, fitted: str, kept: str, expected: Place
) -> None:
    assert told(record, reference_model, worn(other_rig), fitted, kept) is expected


def test_what_is_not_there_at_another_time_is_no_place(
    record: Record, reference_model: Model, other_rig: Any
) -> None:
    """Friction is higher there at first."""
    plant, start = warming(other_rig), {"level_nm": 0.005}
    assert told(record, reference_model, plant, "twice", "twice", start) is Place.GOES
    assert gone({"a": Place.GOES, "b": Place.OPEN, "c": Place.STAYS}) == {"a"}


def diagnosed(
    record: Record, model: Model, plant: Mapping[int, float], way: str, *without: str
) -> Diagnosis:
    fitted = {
        name: one
        for seed in (1, 2)
        for name, one in record(plant, (way,), seed, seconds=SECONDS).items()
    }
    kept = record(plant, (way,), seed=3, seconds=SECONDS)
    return diagnose(model, fitted, kept, without=without)


def test_passed_once_it_may_as_well_be_a_time(
    record: Record, reference_model: Model, other_rig: Any
) -> None:
    result = diagnosed(record, reference_model, worn(other_rig), "once")
    (one,) = (found for found in result.content["findings"] if found["effect"] == NAME)
    assert one["confusable_with"] == ["friction_warmup"]
    assert one["confidence"] <= 0.5
    assert "later" in one["next_experiment"]
    assert any(NAME in limit and "another time" in limit for limit in result.content["limits"])
    untold = diagnosed(record, reference_model, worn(other_rig), "once", "friction_warmup")
    assert "friction_warmup" not in str(untold.content)


def test_passed_twice_it_is_named(record: Record, reference_model: Model, other_rig: Any) -> None:
    result = diagnosed(record, reference_model, worn(other_rig), "twice")
    (one,) = result.content["findings"]
    assert (one["effect"], one["confusable_with"]) == (NAME, [])
    assert one["confidence"] > 0.9
    assert not any(NAME in limit for limit in result.content["limits"])


@pytest.mark.parametrize("without", [(), ("friction_warmup",)])
def test_warming_is_no_place(
    record: Record, reference_model: Model, other_rig: Any, without: tuple[str, ...]
) -> None:
    result = diagnosed(record, reference_model, warming(other_rig), "twice", *without)
    names = [one["effect"] for one in result.content["findings"]]
    assert NAME not in names
    assert without or names == ["friction_warmup"]
