"""A law, or a signal that is wrong: what hold-outs cost less beside, and the other where near."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.search import Searched, likelier

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
