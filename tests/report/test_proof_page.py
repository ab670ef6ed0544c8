"""The page of a proof: goals missed are shown as missed, failures link to their reports."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from eps_hil.proof.run import SEALS, Setting
from eps_hil.report import proof_page

SETTING = Setting(seed=4, quick=False, proof=True, cases=3)


def _line(id: str, kind: str, effect: str, said: list[str], **more: Any) -> dict[str, Any]:
    effects = [] if not effect else [
        {
            "effect": effect, "twins": [], "wanted": 0.6, "effect_to_noise": 0.59,
            "reached": True, "parameters": {"level_nm": 0.04},
        }
    ]  # fmt: skip
    findings = [
        {
            "effect": name, "confidence": 0.9, "confusable_with": ["cogging_torque"],
            "parameters": {"level_nm": {"value": 0.041, "ci95": [0.038, 0.044]}},
        }
        for name in said
    ]  # fmt: skip
    worths = {"baseline": 30.0, "augmented": 14.0, "oracle": 12.0}
    return {
        "id": id, "batch": 1, "failed": False, "report": "", "seconds": 9.0, "problem": "",
        "code": "abc123",
        "worth": {n: {"rack_force_rmse_n": v, "residual_nm": v / 1e4} for n, v in worths.items()},
        "diagnosis": {"verdict": "explained" if said else "no_mismatch", "findings": findings},
        "answer": {
            "kind": kind, "form": "full", "decoy": "" if effect else "nothing", "tolerated": [],
            "effects": effects, "withheld": ["end_stop"], "seconds": 3.0, "can": True,
            "concealment": {
                "wrong_model_fit_percent": 98.7, "seconds_above_noise": 0.1, "naive_err": [],
                "naive_stlsq": ["inertia"],
            },
        },
        **more,
    }  # fmt: skip


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    out = tmp_path_factory.mktemp("proof")
    (out / SEALS).write_text("1 feedbeef\n")
    lines = [
        _line("aaaaaa", "singles", "stribeck", ["stribeck"]),
        _line("bbbbbb", "singles", "stribeck", ["inertia"], report="reports/bbbbbb.html"),
        _line("cccccc", "decoys", "", []),
        _line("dddddd", "decoys", "", [], diagnosis=None, problem="exit status 2: no column"),
    ]
    return out, proof_page.write(out, SETTING, lines)


def test_the_page_stands_alone_and_says_what_was_missed(
    written: tuple[Path, dict[str, Any]],
) -> None:
    out, _ = written
    page = (out / proof_page.PAGE).read_text()
    assert page.count("data:image/png;base64,") == 4
    assert not re.search(r"(src|href)=\"(?!data:|#|reports/)", page)
    assert "MISSED" in page
    assert "seed 4 of the proof seeds" in page.lower()
    assert "feedbeef" in page
    assert "abc123" in page


@pytest.mark.parametrize(("kind", "pictures"), [("loads", 1), ("sizes", 4)])
def test_of_some_kinds_alone_only_what_they_have_is_shown(
    tmp_path: Path, kind: str, pictures: int
) -> None:
    (tmp_path / SEALS).write_text("1 feedbeef\n")
    line = _line("aaaaaa", kind, "stribeck", ["stribeck"])
    line["answer"] |= {"size": "joint", "load": "spring"}
    setting = Setting(seed=4, quick=False, proof=True, cases=1, kinds=(kind,))
    told = proof_page.write(tmp_path, setting, [line])
    assert "no cases" not in told["table"]
    assert "right name first" in told["table"]
    page = (tmp_path / proof_page.PAGE).read_text()
    assert page.count("data:image/png;base64,") == pictures


def test_failures_are_listed_with_report_and_evidence(
    written: tuple[Path, dict[str, Any]],
) -> None:
    out, _ = written
    page = (out / proof_page.PAGE).read_text()
    failures = page[page.index("<h2>Failures: 2 of 4") : page.index("<details><summary>All 4")]
    assert '<a href="reports/bbbbbb.html">bbbbbb</a>' in failures
    assert "98.7" in failures
    assert "exit status 2" in failures
    assert "aaaaaa" not in failures
    assert "cccccc" not in failures


def test_the_result_as_json(written: tuple[Path, dict[str, Any]]) -> None:
    out, content = written
    result = json.loads((out / proof_page.RESULT).read_text())
    assert result == json.loads(json.dumps(content["result"]))
    assert result["schema"] == "eps-hil/proof-concealed/1"
    assert (result["cases"], result["seeds"], result["seed"]) == (4, "proof", 4)
    assert result["failures"] == ["bbbbbb", "dddddd"]
    by_name = {row["figure"]: row for row in result["figures"]}
    assert by_name["false alarms on decoys"]["value"] == 0.5
    assert by_name["right name first, effect/noise 0.6"]["met"] is False
    assert "right name first, effect/noise 0.6" in content["table"]
    for name in ("confusion", "reliability", "concealment", "closed_loop"):
        assert (out / f"{name}.png").stat().st_size > 5000
