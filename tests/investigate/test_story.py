"""What an investigation says of itself."""

import html
from pathlib import Path
from typing import Any

from eps_hil.investigate import story
from eps_hil.investigate.decide import Stop
from eps_hil.investigate.run import Outcome


def begun(**other: Any) -> dict[str, Any]:
    """A round before any recording."""
    return {
        "round": 0, "rig_s": 0.0, "verdict": None, "findings": [], "limits": [], "fit": None,
        "discrepancy": None, "open_effects": ["stribeck"], "open_names": [], "not_told_apart": [],
        "not_shown_here": [], "next": [], "stop": "budget", "why": "too short", "problem": "",
        "tripped": [], **other,
    }  # fmt: skip


def page(content: dict[str, Any], folder: Path) -> str:
    outcome = Outcome([content], None, Stop.BUDGET, 0.0)
    story.write_page(outcome, folder / "p.html", "m.yaml")
    return html.unescape((folder / "p.html").read_text())


def test_without_a_diagnosis_nothing_is_said_to_be_missing_or_not(tmp_path: Path) -> None:
    """It said "Nothing is missing", and 1 times the energy of sensor noise."""
    told = page(begun(), tmp_path)
    assert "no verdict yet" in told
    assert "othing is missing" not in told
    assert "energy of sensor noise" not in told
    told = page(begun(problem="train_1 moves for less than 4 s"), tmp_path)
    assert "no verdict yet: train_1 moves for less than 4 s" in told


def test_experiments_that_all_tripped_are_said() -> None:
    """It was an IndexError, in every later call, too."""
    lines = story.lines(begun(stop=None))
    assert "went beyond a limit before" in lines[-1]
