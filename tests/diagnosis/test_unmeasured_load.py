"""What is said of a load that nobody measured."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from eps_hil.diagnosis import unmeasured_load as module
from eps_hil.diagnosis.balance.load import FREE, Load
from eps_hil.diagnosis.given_load import Asked, Diagnosis
from eps_hil.diagnosis.unmeasured_load import _may_be_load
from eps_hil.physics.model import Model


def _told(effect: str, *terms: dict[str, Any]) -> Diagnosis:
    found = {"effect": effect, "model": {"law": "T_f + 0.1 · h", "terms": list(terms)}}
    return cast(Diagnosis, SimpleNamespace(content={"findings": [found]}))


@pytest.mark.parametrize("name", ["motor_angle_rad", "abs_motor_speed_rad_s", "rack_position_m"])
def test_a_nameless_torque_that_follows_the_motion_may_be_the_load(name: str) -> None:
    (said,) = _may_be_load(_told("unknown", {"where": "rotor", "inputs": [name]}))
    assert "T_f + 0.1 · h" in said
    assert "Record rack_force_n" in said


@pytest.mark.parametrize(
    ("effect", "term"),
    [
        ("unknown", {"where": "rotor", "inputs": ["motor_angle_rad", "motor_torque_nm"]}),
        ("unknown", {"where": "motor", "inputs": ["motor_angle_rad"]}),
        ("cogging_torque", {"where": "rotor", "inputs": ["motor_angle_rad"]}),
    ],
)
def test_what_depends_on_more_or_has_a_name_is_no_load(effect: str, term: dict[str, Any]) -> None:
    assert _may_be_load(_told(effect, term)) == []


def test_an_unknown_without_a_model_says_nothing_of_the_load() -> None:
    told = cast(Diagnosis, SimpleNamespace(content={"findings": [{"effect": "unknown"}]}))
    assert _may_be_load(told) == []


@pytest.mark.parametrize(
    ("names", "price", "unknown", "chosen"),
    [
        ({"stribeck"}, 1.0, False, "load"),
        (set(), 1.0, False, "load"),
        ({"stribeck", "unmodelled_spring"}, 1.0, False, "names"),
        ({"unmodelled_spring"}, 99.0, False, "load"),
        ({"stribeck"}, 1.0, True, "names"),
    ],
    ids=["hidden by no load", "none", "hidden by a load", "too dear", "unknown beside the load"],
)
def test_names_are_weighed_against_a_load_that_hides_them(
    names: set[str],
    price: float,
    unknown: bool,
    chosen: str,
    monkeypatch: pytest.MonkeyPatch,
    reference_model: Model,
) -> None:
    """And not told at all where there is nothing to weigh: that takes most of a diagnosis.

    They are looked for in the model as it was given: with a drag that was refitted beside an
    assumed load, a late torque came with the opposite drag as a finding.
    """
    of_load, of_names = (
        cast(
            Diagnosis,
            SimpleNamespace(
                content={"findings": [{}]},
                price=one,
                beside_load=None,
                problem=None,
                judged=[],
                remainder=unknown or None,
            ),
        )
        for one in (10.0, price)
    )
    with_load = replace(reference_model, inertia_kg_m2=1.0)
    asked = Asked(with_load, [], [], None, ())
    told: list[str] = []

    def tell() -> Diagnosis:
        told.append("told")
        return of_names

    def begun(_load: Load, so_asked: Asked) -> Any:
        assert so_asked.model is reference_model
        return SimpleNamespace(names=names, told=tell)

    monkeypatch.setattr(module, "_under_likely_load", lambda *_: of_load)
    monkeypatch.setattr(module, "may_be_free", lambda *_: True)
    monkeypatch.setattr(module, "price_of_one", lambda *_: 1.0)
    monkeypatch.setattr(module, "begun", begun)
    found = module._under_load(FREE, asked, reference_model)
    assert found is (of_names if chosen == "names" else of_load)
    assert bool(told) == (unknown or "unmodelled_spring" in names)
