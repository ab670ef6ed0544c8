"""What is said of a load that nobody measured."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from eps_hil.diagnosis import unmeasured_load as module
from eps_hil.diagnosis.balance.load import FREE
from eps_hil.diagnosis.given_load import Asked, Diagnosis
from eps_hil.diagnosis.unmeasured_load import _may_be_load


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
    ("names", "price", "chosen"),
    [
        ({"stribeck"}, 1.0, "load"),
        (set(), 1.0, "load"),
        ({"stribeck", "unmodelled_spring"}, 1.0, "names"),
        ({"unmodelled_spring"}, 99.0, "load"),
    ],
    ids=["hidden by no load", "none", "hidden by a load", "too dear"],
)
def test_names_are_weighed_against_a_load_that_hides_them(
    names: set[str], price: float, chosen: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not told at all where there is nothing to weigh: that takes most of a diagnosis."""
    of_load, of_names = (
        cast(
            Diagnosis,
            SimpleNamespace(
                content={"findings": [{}]}, price=one, beside_load=None, problem=None, judged=[]
            ),
        )
        for one in (10.0, price)
    )
    asked = cast(Asked, SimpleNamespace(every=[], model=None))
    told: list[str] = []

    def tell() -> Diagnosis:
        told.append("told")
        return of_names

    monkeypatch.setattr(module, "_under_likely_load", lambda *_: of_load)
    monkeypatch.setattr(module, "may_be_free", lambda *_: True)
    monkeypatch.setattr(module, "price_of_one", lambda *_: 1.0)
    monkeypatch.setattr(module, "begun", lambda *_: SimpleNamespace(names=names, told=tell))
    found = module._under_load(FREE, asked)
    assert found is (of_names if chosen == "names" else of_load)
    assert bool(told) == ("unmodelled_spring" in names)
