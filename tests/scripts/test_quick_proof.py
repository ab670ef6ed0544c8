"""CI's verdict on a quick proof (scripts/ci/quick_proof.py)."""

from types import SimpleNamespace
from typing import Any

import pytest

from tests.loaded import loaded

CHECK = loaded("scripts/ci/quick_proof.py")
GOOD: dict[str, Any] = {
    "answered": True, "kind": "singles", "clean": True, "level": 1.5, "right_first": True,
    "truths": ("stribeck",),
}  # fmt: skip


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({}, ""),
        ({"level": 0.6, "right_first": False}, ""),
        ({"right_first": False}, "stribeck at 1.5 is not named"),
        ({"answered": False, "kind": "crowds"}, "no diagnosis: killed"),
        ({"kind": "decoys", "clean": False}, "a false alarm"),
        ({"kind": "aliens", "right_first": False}, ""),
    ],
)
def test_what_a_few_cases_must_show(
    monkeypatch: pytest.MonkeyPatch, other: dict[str, Any], said: str
) -> None:
    """It ended with status 0 whatever was found."""
    judged = SimpleNamespace(**{**GOOD, **other})
    monkeypatch.setattr(CHECK, "judgement", lambda _: judged)
    found = CHECK.problems([{"id": "7", "problem": "killed", "answer": {"kind": judged.kind}}])
    assert [said in one for one in found] == [True] * bool(said)


def test_no_case_is_a_problem() -> None:
    assert CHECK.problems([]) == ["no case was run"]
