"""A finding speaks of what the rig was compared with, whatever its effect's sentence calls it."""

import re

import pytest

from eps_hil.diagnosis.verdict.whom import against
from eps_hil.physics.effects.catalogue import catalogue


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("It is 2 times what the model says.", "It is 2 times what it is in the simulator."),
        ("It is later than the model file says.", "It is later than in the simulator."),
        ("An effect that the model does not have.", "An effect that the simulator does not have."),
        ("It slips.", "It slips."),
    ],
)
def test_the_model_gives_its_place(before: str, after: str) -> None:
    (said,) = against([{"effect": "inertia", "summary": before}], "the simulator")
    assert said["summary"] == after
    (was,) = against([{"effect": "inertia", "summary": before}], "day one", "First: ", verb="was")
    assert was["summary"].startswith("First: ")
    assert ("it was in day one" in was["summary"]) is ("what the model says" in before)
    (unknown,) = against([{"effect": "unknown", "summary": before}], "the simulator")
    assert unknown["summary"] == before


@pytest.mark.parametrize("name", catalogue())
def test_no_sentence_of_the_catalogue_keeps_the_model(name: str) -> None:
    effect = catalogue()[name]
    for sentence in (effect.sentence, effect.sentence_negative):
        (said,) = against([{"effect": name, "summary": sentence or ""}], "the first state")
        assert not re.search(r"\bmodel\b", said["summary"])
