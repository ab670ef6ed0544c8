"""Names beside a law that has none: found where they are there, and not where they are not."""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest

from eps_hil.diagnosis.accept import beside_law as module
from eps_hil.diagnosis.accept.beside_law import beside_law, names_beside
from eps_hil.diagnosis.accept.holdout_support import holdout_support
from eps_hil.diagnosis.attribute.select import Selection, select
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem, term_of
from eps_hil.diagnosis.remainder.find import rounded

BRAKE_NM, SPRING = 0.05, 4e-4


@pytest.mark.slow
@pytest.mark.parametrize("spring", [SPRING, 0.0])
def test_a_spring_beside_an_eddy_current_brake(
    fitted_and_kept: Callable[..., Any], other_rig: ModuleType, spring: float
) -> None:
    """The brake leaves many times what the spring does; alone, it brings no name with it."""
    plant = {other_rig.EDDY: BRAKE_NM, other_rig.EDDY_W: 30.0, other_rig.SPRING: spring}
    problem, judged = fitted_and_kept(plant)
    selection = select(problem)
    findings = holdout_support(problem, selection, judged)
    found = beside_law(problem, ((selection, ()), (selection, findings)), judged, measured=True)
    if not spring:
        assert found is None
        return
    assert found is not None
    (k,) = found.findings
    entry = found.selection.found.entries[k]
    assert entry["effect"] == "unmodelled_spring"
    half = found.selection.found.half_width[k, "stiffness_nm_per_rad"]
    assert entry["stiffness_nm_per_rad"] == pytest.approx(spring, abs=max(half, 0.03 * spring))
    assert found.remainder.share > 0.95
    assert {"unmodelled_spring", "empirical"} == {
        str(one["effect"]) for one in found.remainder.model.effects
    }
    for one in found.remainder.model.effects:  # as a file is written
        assert dict(one) == rounded(one)
    assert len(found.selection.found.own) == len(
        [name for name in found.told.found.own if not name.startswith("law.")]
    )


def test_a_name_is_weighed_against_what_is_left_where_it_acts(problem: Problem) -> None:
    """A torque that the model has too much late in a recording; friction is warm by then."""
    late = {
        "effect": "empirical", "form": "law", "where": "rotor", "how": "sum",
        "inputs": ["time_s"], "memory": ["none"], "shapes": ["above"],
        "size": 0.02, "centre_1": 6.0, "range": {"time_s": [0.0, 60.0]},
    }  # fmt: skip
    stribeck = {"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 10.0}
    beside = Problem(problem.recordings, replace(problem.model, effects=(late, stribeck)))
    warm = {"effect": "friction_warmup", "time_s": 1.0, "amplitude": 0.2}
    found = fit(beside, [warm], 0)
    everywhere, there = module.unexplained(beside, found), module.unexplained(beside, found, 0)
    assert everywhere > 1e4
    assert there < 0.2 * everywhere


@pytest.mark.parametrize(("from_s", "stands"), [(9.0, True), (2.0, False)])
def test_a_name_stands_where_a_law_fails_only_for_a_while(
    problem: Problem, from_s: float, stands: bool
) -> None:
    """A torque that the model has too much of late, or nearly always, beside cogging."""
    late = {
        "effect": "empirical", "form": "law", "where": "rotor", "how": "sum",
        "inputs": ["time_s"], "memory": ["none"], "shapes": ["above"],
        "size": 0.02, "centre_1": from_s, "range": {"time_s": [0.0, 60.0]},
    }  # fmt: skip
    cogging = {"effect": "cogging_torque", "order": 8.0, "amplitude_nm": 0.004, "phase_rad": 0.0}
    stribeck = {"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 10.0}
    effects = (late, stribeck, cogging)
    beside = Problem(problem.recordings, replace(problem.model, effects=effects))
    opposite = {**cogging, "phase_rad": 3.14159, "term": "cogging_torque 8"}
    without, found = fit(beside, [], 0), fit(beside, [opposite], 0)
    told = Selection(without, found, [], beside, found)
    term = term_of(found.entries[0])
    told.without, told.gains = {term: without}, {term: without.cost - found.cost}
    assert told.gains[term] < module.unexplained(beside, found, 0)
    assert module._outweighs(beside, told, 0) is stands


def test_what_a_refused_curve_held_is_searched_for_without_it(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    nothing = fit(problem, [])
    curve = {"effect": "position_torque", "curve": [[-0.05, 0.0], [0.0, 0.01], [0.05, 0.0]]}
    asked: list[set[str]] = []

    def chosen(_problem: Problem, _say: object, without: set[str], _settled: object) -> Selection:
        asked.append(without)
        found = nothing if "position_torque" in without else replace(nothing, entries=(curve,))
        return Selection(nothing, found, [], problem, found)

    def refused(_problem: Problem, told: Selection, _judged: object) -> list[int]:
        told.found = nothing
        return []

    before = Selection(nothing, nothing, [], problem, nothing)
    monkeypatch.setattr(module, "select", chosen)
    monkeypatch.setattr(module, "holdout_support", refused)
    assert names_beside(problem, before, {"backlash"}, [], measured=False)[1] == []
    assert asked == [{"backlash"}, {"backlash", "position_torque"}]
    asked.clear()
    names_beside(problem, before, {"position_torque"}, [], measured=False)
    assert len(asked) == 1
