"""The same recordings said otherwise, in other units, of another size, or recorded worse."""

from collections.abc import Callable, Mapping
from itertools import product
from types import ModuleType
from typing import Any

import pytest

from eps_hil.physics.model import Model
from tests.loaded import loaded

pytestmark = pytest.mark.slow

Columns = Mapping[str, Mapping[str, Any]]


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    return loaded("benchmarks/said_otherwise.py")


@pytest.fixture(scope="module")
def recorded(other_rig: ModuleType) -> Callable[[str], Columns]:
    """Recordings of the rig of other code, by what it hides."""
    hidden = {
        "nothing": {},
        "gain and stribeck": {
            other_rig.EM_GAIN: 0.95,
            other_rig.STRIB: 0.03,
            other_rig.STRIB_W: 10.0,
        },
    }

    def make(what: str) -> Columns:
        effects = other_rig.Effects(hidden[what])
        return {
            name: other_rig.record(effects, manoeuvre, 100 + k, 1.0, 15.0)
            for k, (name, manoeuvre) in enumerate(
                (("sweep", "sweep"), ("weave", "weave"), ("slow", "slow"), ("holdout", "weave"))
            )
        }

    return make


@pytest.fixture(scope="module")
def first(
    bench: ModuleType, recorded: Callable[[str], Columns], reference_model: Model
) -> Callable[[str], tuple[Columns, dict[str, Any]]]:
    found: dict[str, tuple[Columns, dict[str, Any]]] = {}

    def make(what: str) -> tuple[Columns, dict[str, Any]]:
        if what not in found:
            columns = recorded(what)
            found[what] = columns, bench.diagnosed(columns, reference_model)
        return found[what]

    return make


def names(content: Mapping[str, Any]) -> list[str]:
    return sorted(one["effect"] for one in content["findings"])


BOTH = (
    *("zero", "500 Hz", "100 Hz", "noise", "held", "joined"),
    *("turned", "gear 20", "gear 4", "gear 0.1", "strong"),
)
ONE = ("later", "200 Hz", "cut", "rack 20", "weak")


@pytest.mark.parametrize(
    ("hidden", "variant"),
    [
        *product(("nothing", "gain and stribeck"), BOTH),
        *product(("gain and stribeck",), ONE),
    ],
)
def test_what_is_found_does_not_depend_on_how_it_is_said(
    bench: ModuleType,
    first: Callable[[str], tuple[Columns, dict[str, Any]]],
    reference_model: Model,
    hidden: str,
    variant: str,
) -> None:
    columns, before = first(hidden)
    assert names(before) == ([] if hidden == "nothing" else ["motor_torque_gain", "stribeck"])
    other, model, units = bench.VARIANTS[variant](columns, reference_model)
    after = bench.diagnosed(other, model)
    assert names(after) == names(before)
    assert bench.outside(before, after, units) == []


@pytest.mark.parametrize("variant", ["gear 20", "gear 4", "strong"])
def test_a_stiff_belt_behind_a_gear_is_none(
    bench: ModuleType, reference_model: Model, variant: str
) -> None:
    """On the proof's plant, whose five masses give a little."""
    other, model, _ = bench.VARIANTS[variant](
        bench.record_of("gain_stribeck", 1, None), reference_model
    )
    content = bench.diagnosed(other, model)
    assert names(content) == ["motor_torque_gain", "stribeck"]


def test_an_interval_that_is_missed_is_told(bench: ModuleType) -> None:
    def told(value: float) -> dict[str, Any]:
        ends = [value - 0.01, value + 0.01]
        numbers = {"level_nm": {"value": value, "unit": "Nm", "ci95": ends}}
        return {"findings": [{"effect": "stribeck", "parameters": numbers}]}

    assert bench.outside(told(0.1), told(5.0), {"Nm": 50.0}) == []
    assert bench.outside(told(0.1), told(0.2), {}) == ["level_nm 0.2 was 0.1"]
