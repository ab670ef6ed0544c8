"""The judge counts what a reader would count."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.proof import score
from eps_hil.proof.judge import failed, judge
from eps_hil.proof.laws import slip_friction
from eps_hil.proof.seal import seal
from eps_hil.proof.truth import Drive, maxwell_slip


def _answer(*effects: str, kind: str = "singles", **more: Any) -> dict[str, Any]:
    twins = {"stribeck": ["breakaway_dwell"]}
    return {
        "kind": kind,
        "form": "simple",
        "decoy": "",
        "tolerated": [],
        "effects": [
            {
                "effect": effect,
                "twins": twins.get(effect, []),
                "wanted": 0.6,
                "parameters": {"level_nm": 0.04},
            }
            for effect in effects
        ],
        **more,
    }


def _said(*effects: str, verdict: str = "explained", **more: Any) -> dict[str, Any]:
    findings = [{"effect": e, "confidence": 0.9, "confusable_with": [], **more} for e in effects]
    return {"verdict": verdict, "findings": findings}


def test_the_right_name() -> None:
    j = judge("a", _answer("stribeck"), _said("stribeck"))
    assert j.right_first
    assert j.in_set == ("stribeck",)
    assert not j.invented
    assert j.stated == ((0.9, True),)


def test_a_twin_that_names_it_is_in_the_set_but_not_first() -> None:
    said = _said("breakaway_dwell", confusable_with=["stribeck"])
    j = judge("a", _answer("stribeck"), said)
    assert not j.right_first
    assert j.in_set == ("stribeck",)
    assert not j.invented


def test_beside_a_load_it_is_enough_to_say_that_it_hides_the_effect() -> None:
    answer = _answer("unmodelled_spring", kind="loads", load="spring")
    silent = {"verdict": "no_mismatch", "findings": [], "limits": []}
    assert failed(judge("a", answer, silent))
    said = {**silent, "limits": ["unmodelled_spring cannot be told from such a load."]}
    j = judge("a", answer, said)
    assert j.told_hidden == ("unmodelled_spring",)
    assert j.group == "spring"
    assert not failed(j)
    assert failed(judge("a", answer, {**said, "findings": _said("inertia")["findings"]}))


def test_a_load_that_has_no_name_may_be_called_unknown() -> None:
    said = _said("unknown", verdict="unknown_effect")
    assert judge("a", _answer(kind="loads", load="scrub"), said).clean
    assert not judge("a", _answer(kind="loads", load="spring"), said).clean
    invented = _said("unknown", "inertia", verdict="unknown_effect")
    assert not judge("a", _answer(kind="loads", load="scrub"), invented).clean


def test_a_stranger_is_invented() -> None:
    j = judge("a", _answer("stribeck"), _said("stribeck", "inertia"))
    assert j.right_first
    assert j.invented == ("inertia",)
    assert not j.clean


def test_silence_and_absence_are_misses() -> None:
    silent = judge("a", _answer("stribeck"), {"verdict": "no_mismatch", "findings": []})
    absent = judge("a", _answer("stribeck"), None)
    for j in (silent, absent):
        assert not j.right_first
        assert not j.in_set
    assert silent.answered
    assert not absent.answered
    assert not judge("a", _answer(kind="decoys"), None).clean


def test_decoys() -> None:
    decoy = _answer(kind="decoys")
    assert judge("a", decoy, {"verdict": "no_mismatch", "findings": []}).clean
    assert not judge("a", decoy, _said("stribeck")).clean
    assert not judge("a", decoy, _said("unknown", verdict="unknown_effect")).clean
    off = _answer(kind="decoys", tolerated=["inertia"])
    assert judge("a", off, _said("inertia")).clean


def test_what_is_tolerated_neither_counts_nor_hides_the_first_name() -> None:
    answer = _answer("stribeck", tolerated=["presliding_hysteresis"])
    j = judge("a", answer, _said("presliding_hysteresis", "stribeck"))
    assert j.right_first
    assert not j.invented


def _pair_that_cancels(offset_nm: float) -> dict[str, Any]:
    said = _said("stribeck", "friction_asymmetry", "motor_torque_offset")
    said["findings"][1]["parameters"] = {"half_difference_nm": {"value": 0.026}}
    said["findings"][2]["parameters"] = {"offset_nm": {"value": offset_nm}}
    return said


def test_how_unequal_slip_elements_reverse_is_nothing_invented() -> None:
    full = _answer("stribeck", form="full")
    assert not judge("a", full, _pair_that_cancels(0.0258)).invented
    assert judge("a", full, _pair_that_cancels(0.01)).invented == (
        "friction_asymmetry",
        "motor_torque_offset",
    )
    assert judge("a", _answer("stribeck"), _pair_that_cancels(0.0258)).invented  # LuGre: wrong


def test_unequal_slip_elements_are_equal_ones_beside_a_constant() -> None:
    """The reason for that tolerance, on the plant's own friction."""
    d, slip = Drive(), maxwell_slip()
    forth, back = 0.05, 0.12
    unequal, equal = np.zeros(6), -0.5 * (forth - back) * slip.level_share
    rng = np.random.default_rng(2)
    for speed in np.repeat(rng.normal(0.0, 0.4, 60), 50):
        one = slip_friction(d, slip, unequal, speed, forth, back, 1e-3)
        half = 0.5 * (forth + back)
        other = slip_friction(d, slip, equal, speed, half, half, 1e-3)
        assert one == pytest.approx(other + 0.5 * (forth - back), abs=1e-12)


def test_a_pair_has_two_names() -> None:
    answer = _answer("inertia", "stribeck", kind="pairs")
    j = judge("a", answer, _said("stribeck"))
    assert j.named == ("stribeck",)
    assert set(judge("a", answer, _said("stribeck", "inertia")).named) == {"stribeck", "inertia"}


@pytest.mark.parametrize(
    ("effect", "name", "true", "value", "error"),
    [
        ("stribeck", "level_nm", 0.04, 0.05, 0.25),
        ("motor_torque_gain", "gain", 1.04, 1.05, 0.25),
        ("rack_ratio", "scale", 0.04, 0.05, 0.25),
        ("inertia", "scale", 0.96, 0.95, -0.25),
        ("cogging_torque", "phase_rad", 3.1, -3.1, (2 * 3.14159265 - 6.2) / 3.14159265),
    ],
)
def test_parameter_errors_are_relative_to_what_is_hidden(
    effect: str, name: str, true: float, value: float, error: float
) -> None:
    answer = _answer(effect)
    answer["effects"][0]["parameters"] = {name: true}
    low, high = sorted((value - 0.02, value + 0.02))
    said = _said(effect, parameters={name: {"value": value, "ci95": [low, high]}})
    (estimate,) = judge("a", answer, said).estimates
    assert estimate.relative_error == pytest.approx(error, abs=1e-6)
    assert estimate.covered is (abs(error) * (3.1416 if "phase" in name else 0.04) < 0.02)


def test_wilsons_interval() -> None:
    low, high = score.Share("x", 48, 50).interval  # Newcombe 1998 tabulates the formula
    assert low == pytest.approx(0.8654, abs=1e-3)
    assert high == pytest.approx(0.9890, abs=1e-3)
    assert score.Share("x", 0, 300).interval[1] == pytest.approx(0.0126, abs=1e-3)


def test_the_table_over_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cases = {
        "aa": _answer("stribeck"),
        "bb": _answer("inertia"),
        "cc": _answer(kind="decoys", decoy="nothing"),
        "dd": _answer("eddy", kind="aliens"),
    }
    value = seal(tmp_path / "answers.json", cases)
    results = tmp_path / "results"
    results.mkdir()
    (results / "aa.json").write_text(json.dumps(_said("stribeck")))
    (results / "cc.json").write_text(json.dumps({"verdict": "no_mismatch", "findings": []}))
    (results / "dd.json").write_text(json.dumps(_said("unknown", verdict="unknown_effect")))
    out = tmp_path / "score.json"
    assert score.main([str(tmp_path), str(results), "--seal", value, "--json", str(out)]) == 0
    table = {s["what"]: (s["hits"], s["cases"]) for s in json.loads(out.read_text())["shares"]}
    assert table["simple singles at 0.6: right name first"] == (1, 2)
    assert table["simple decoys: false alarm"] == (0, 1)
    assert table["simple aliens: said to be unknown"] == (1, 1)
    assert "bb singles 0.6: inertia → no diagnosis" in capsys.readouterr().out
    assert score.main([str(tmp_path), str(results), "--seal", "0" * 64]) == 2


@pytest.mark.parametrize("kind", ["singles", "pairs", "crowds", "decoys", "aliens", "poor"])
def test_a_table_of_one_kind_has_each_row_once(kind: str) -> None:
    answer = _answer(*([] if kind == "decoys" else ["stribeck"]), kind=kind, decoy="nothing")
    answer["concealment"] = {"naive_err": ["stribeck"], "naive_stlsq": []}
    rows = score.shares([judge(id, answer, None) for id in ("a", "b")])
    names = [row.what for row in rows]
    assert names
    assert len(set(names)) == len(names)
    assert {row.cases for row in rows} == {2}
    by_err = [row.hits for row in rows if "ERR" in row.what]
    assert by_err in ([], [2])
    assert score.report([judge("a", answer, None)]).count(" → no diagnosis") == 1
