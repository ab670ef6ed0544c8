"""What makes hold-outs worse does not stand in the written model, whatever let it through."""

from typing import Any

import pytest

from eps_hil.diagnosis.accept import holdout_support
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.accept.standing import standing
from eps_hil.diagnosis.attribute.channel_fault import no_worse
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem

pytestmark = pytest.mark.slow

STRIBECK = {"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 10.0}
WRONG = {"effect": "torque_sensor_gain", "gain": 1.03}


def selected(problem: Problem, entries: list[dict[str, Any]]) -> Selection:
    found = fit(problem, entries, 0)
    gains = {str(entry["effect"]): 1e3 for entry in entries}
    return Selection(found, found, [], problem, found, gains=gains)


def kept(problem: Problem) -> list[Holdout]:
    return [Holdout(one, {}) for one in problem.recordings]


def as_it_is(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without refits, which would put a wrong number right."""
    monkeypatch.setattr(
        holdout_support, "fit", lambda problem, entries, **_: fit(problem, entries, 0)
    )
    monkeypatch.setattr(holdout_support, "timed", lambda _problem, found: found)


def test_a_finding_that_makes_the_hold_outs_worse_goes(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    as_it_is(problem, monkeypatch)
    selection = selected(problem, [WRONG, STRIBECK])
    (place,) = standing(problem, selection, [0, 1], kept(problem))
    assert selection.found.entries[place]["effect"] == "stribeck"
    assert standing(problem, selected(problem, [WRONG]), [0], kept(problem)) == []


def test_what_stood_only_beside_a_name_that_went_goes_with_it(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A ratio and a sensor's gain that cancel each other; the ratio was ruled out elsewhere."""
    as_it_is(problem, monkeypatch)
    ratio = {"effect": "rack_ratio", "scale": -0.03}
    selection = selected(problem, [STRIBECK, ratio, WRONG])
    left = standing(problem, selection, [0, 2], kept(problem))
    assert [selection.found.entries[k]["effect"] for k in left] == ["stribeck"]


def test_one_number_pays_for_no_more_than_it_spares() -> None:
    assert no_worse(1.0100, 1.0107, spared=2, samples=1600, share=1.0)
    assert not no_worse(1.0100, 1.0107, spared=0, samples=1600, share=1.0)
    assert not no_worse(1.0100, 1.03, spared=2, samples=1600, share=1.0)
    assert no_worse(1.0107, 1.0050, spared=-1, samples=1600, share=1.0)


def test_a_signal_that_stands_for_no_name_has_to_explain_the_hold_outs_as_well() -> None:
    """A torsion bar 60 ms late took all that was fitted beside a load, and 2 % of the rest."""
    assert not no_worse(2.6, 2.57, spared=0, samples=1600, share=1.0)
    assert no_worse(2.6, 1.5, spared=0, samples=1600, share=1.0)
    assert no_worse(2.6, 2.1, spared=0, samples=1600, share=0.5)
