"""Which of two explanations is told: a law or a signal that is wrong, names or what has none."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import ModuleType, SimpleNamespace
from typing import Any, cast

import pytest

from eps_hil.diagnosis import search
from eps_hil.diagnosis.accept import standing
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.attribute.select import Selection, select
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.search import Names, Searched, cheapest, likelier

LAW = SimpleNamespace(entries=({"shapes": ["linear"]},))


@pytest.mark.parametrize(
    ("of_law", "of_channel", "said"),
    [
        (5000.0, 5003.0, "law, or channel"),
        (5003.0, 5000.0, "channel, or law"),
        (5000.0, 5100.0, "law"),
        (5100.0, 5000.0, "channel"),
    ],
)
def test_of_two_explanations_the_dearer_is_told_where_it_is_hardly_dearer(
    problem: Problem, of_law: float, of_channel: float, said: str
) -> None:
    nothing = fit(problem, [])
    selection = Selection(nothing, nothing, [], problem, nothing)
    judged = [Holdout(problem.recordings[1], {})]
    given, right = (
        cast("Searched", (None, problem, selection, list(judged))) for _ in ("law", "channel")
    )

    def told(one: Searched) -> Any:
        if one is given:
            return SimpleNamespace(words="law", price=of_law, remainder=LAW)
        return SimpleNamespace(words="channel", price=of_channel, remainder=None)

    def beside(best: Any, other: Any) -> Any:
        return SimpleNamespace(words=f"{best.words}, or {other.words}")

    assert likelier(given, right, told, beside).words == said


@pytest.mark.parametrize(("more", "told"), [(0.0, ["stribeck"]), (4.0, [])])
def test_names_that_leave_little_are_not_given_up_for_something_unknown(
    monkeypatch: pytest.MonkeyPatch,
    fitted_and_kept: Callable[[Mapping[int, float]], tuple[Problem, list[Holdout]]],
    other_rig: ModuleType,
    more: float,
    told: list[str],
) -> None:
    """Names that leave hold-outs ``more`` than as much again as noise may stand in for it."""
    problem, judged = fitted_and_kept({other_rig.STRIB: 0.03, other_rig.STRIB_W: 10.0})
    selection = select(problem)
    names = Names(problem, selection, selection, [0], None)
    nothing = replace(names, findings=[])

    def dearer(*given: Any) -> float:
        samples = sum(int(one.judging(problem.model).sum()) for one in judged)
        return standing.price(*given) + more * samples

    monkeypatch.setattr(search, "price", dearer)
    found = cheapest(problem, names, nothing, judged, {}, None)
    assert [found.shown.found.entries[k]["effect"] for k in found.findings] == told
