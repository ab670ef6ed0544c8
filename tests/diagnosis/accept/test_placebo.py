"""Placebo terms gain nothing where a finding does."""

from collections.abc import Callable
from typing import Any

import pytest

from eps_hil.diagnosis.accept.placebo import DRAWS, as_lucky, placebos
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.model import Model

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def explained(record: Callable[..., Any], reference_model: Model, other_rig: Any) -> Diagnosis:
    """A Stribeck effect and a torque sensor's offset, in two recordings and a hold-out."""
    plant = {other_rig.STRIB: 0.04, other_rig.STRIB_W: 10.0, other_rig.EM_OFF: 0.02}
    fitted = record(plant, ("sweep", "weave"), seconds=12.0)
    return diagnose(reference_model, fitted, record(plant, ("weave",), 2, seconds=12.0))


def test_a_finding_gains_and_its_placebos_do_not(explained: Diagnosis) -> None:
    terms = {one["effect"]: one for one in explained.content["fit"]["placebo"]}
    assert set(terms) == {one["effect"] for one in explained.content["findings"]}
    term = terms["stribeck"]
    for low, middle, high in term["placebo_gain_5_50_95_percent"].values():
        assert low <= middle <= high < 0.15 * term["gain"]
        assert middle < 0.02 * term["gain"]
    left = term["left_over_n"]
    assert left["with"] < 0.5 * left["luckiest_placebo"] < 0.5 * 1.01 * left["without"]


def test_an_offset_is_not_shifted(explained: Diagnosis) -> None:
    """It would be the same term again, and gain as much."""
    (offset,) = (o for o in explained.content["fit"]["placebo"] if o["effect"] != "stribeck")
    quantiles = offset["placebo_gain_5_50_95_percent"]
    assert quantiles["shifted"] == []
    assert abs(quantiles["random_signs"][1]) < 0.05 * offset["gain"]


def test_a_name_that_gains_what_a_placebo_may_is_luck(explained: Diagnosis) -> None:
    told = explained.content["fit"]["placebo"]
    rest = (explained.problem, explained.selection, explained.accepted, explained.judged)
    assert as_lucky(told, *rest) == []
    chance = max(ends[-1] for ends in told[0]["placebo_gain_5_50_95_percent"].values() if ends)
    for gain, lucky in ((-1.0, True), (1.9 * chance, True), (2.1 * chance, False)):
        found = as_lucky([{**told[0], "gain": gain}, *told[1:]], *rest)
        assert found == ([told[0]["effect"]] if lucky else [])


def test_the_seed_decides(explained: Diagnosis) -> None:
    asked = (explained.problem, explained.selection, explained.accepted, explained.judged)
    first = placebos(*asked)
    assert first == explained.content["fit"]["placebo"]
    assert placebos(*asked, seed=1) != first
    assert all(one["draws"] == DRAWS for one in first)
