"""What changed between two states: planned evenly, hidden, sealed, judged."""

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.proof import cases, states
from eps_hil.proof.changed import (
    ChangePlan,
    Desk,
    change_plans,
    figures,
    hide,
    judge_change,
    prove_changes,
    words_for,
)
from eps_hil.proof.effects import ALIENS
from eps_hil.proof.examine import Examined
from eps_hil.proof.plans import PROOF_SEEDS
from eps_hil.proof.states import TwoStates


def test_half_of_the_plans_hold_a_change_and_every_mixture_comes() -> None:
    planned = change_plans(3, 16, proof=True)
    assert sum(bool(one.change) for one in planned) == 8
    mixtures = {(bool(one.change), one.gone, bool(one.shared)) for one in planned}
    assert len(mixtures) == 8
    assert {one.shared for one in planned if one.shared} <= set(ALIENS)
    assert all(one.seed >= PROOF_SEEDS for one in planned)
    assert planned == change_plans(3, 16, proof=True)
    seeds = {one.seed for one in planned}
    assert not seeds & {one.seed for one in change_plans(3, 16, proof=False)}


NEW = {"change": "stribeck"}
NONE = {"change": ""}


@pytest.mark.parametrize(
    ("answer", "names", "right", "false"),
    [
        (NEW, ["stribeck"], True, ()),
        (NEW, ["breakaway_dwell"], True, ()),  # recordings may not tell them apart
        (NEW, ["stribeck", "quadratic_drag"], False, ("quadratic_drag",)),
        (NEW, ["unknown"], False, ()),
        (NEW, [], False, ()),
        (NONE, [], True, ()),
        (NONE, ["unknown"], False, ()),
        (NONE, ["stribeck"], False, ("stribeck",)),
    ],
)
def test_an_answer_is_judged(
    answer: dict[str, str], names: list[str], right: bool, false: tuple[str, ...]
) -> None:
    content = {"findings": [{"effect": name} for name in names]}
    judged = judge_change(answer, content)
    assert (judged.right, judged.false) == (right, false)


def test_no_answer_is_wrong() -> None:
    assert not judge_change(NONE, None).right


def test_gone_is_new_with_both_states_exchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def made(seed: int, shared: Any, change: Any) -> TwoStates:
        asked.append((seed, shared, change))
        states = [{"train_1": {"time_s": np.array([0.0, at])}} for at in (1.0, 2.0)]
        return TwoStates(states[0], states[1], 0.61)

    monkeypatch.setattr("eps_hil.proof.changed.two_states", made)
    answer = hide(ChangePlan(5, "quadratic_drag", shared="eddy_brake"), tmp_path / "new")
    hide(ChangePlan(5, "quadratic_drag", gone=True), tmp_path / "gone")
    assert asked[0] == (5, [("eddy_brake", 3.0)], ("quadratic_drag", 0.6))
    assert answer["ratio"] == 0.61
    told = {
        (case, word): (tmp_path / case / f"{word}_1.csv").read_text()
        for case in ("new", "gone")
        for word in ("before", "after")
    }
    assert told["new", "before"] == told["gone", "after"]
    assert told["new", "after"] == told["gone", "before"] != told["new", "before"]
    assert words_for(tmp_path / "new")[-4:] == [
        "--before",
        "before_1.csv",
        "--after",
        "after_1.csv",
    ]


def test_a_change_has_its_size_in_the_state_that_holds_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """An end stop within the travel of one programme lies outside that of another."""
    programmes, sized = iter([["a1", "a2", "a3"], ["b1", "b2", "b3"]]), {}

    def hide_one(_ground: Any, base: Any, effect: Any, ratio: float, training: Any, *_: Any,
                 **__: Any) -> Any:  # fmt: skip
        sized[effect.id] = (base, training)
        kept = SimpleNamespace(apply=lambda world, *_: world)
        return SimpleNamespace(effect=kept, strength=1.0, shape={}, ratio=ratio)

    monkeypatch.setattr(states, "programme", lambda *_: next(programmes))
    monkeypatch.setattr(states, "measured", lambda *_: {})
    for name, done in {
        "usual_noise": lambda *_: 1.0,
        "measure": lambda _ground, training, _noise: training,
        "noiseless": lambda *_: {},
        "hide": hide_one,
    }.items():
        monkeypatch.setattr(cases, name, done)
    made = states.two_states(5, [("alien_heat_loss", 3.0)], ("end_stop", 0.6))
    assert made.reached == 0.6
    assert sized == {
        "alien_heat_loss": (["a1", "a2"], ["a1", "a2"]),
        "end_stop": (["b1", "b2"], ["b1", "b2"]),
    }


def hidden(plan: ChangePlan, folder: Path) -> dict[str, Any]:
    """A case without recordings."""
    folder.mkdir(parents=True)
    for name in ("before_1.csv", "after_1.csv", "model.yaml"):
        (folder / name).write_text("x")
    return {"change": plan.change, "gone": plan.gone, "shared": plan.shared, "seed": plan.seed}


def test_batches_are_sealed_before_they_are_asked_and_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("eps_hil.proof.changed.hide", hidden)
    out, asked, said = tmp_path / "out", list[str](), list[str]()

    def ask(cases: Path, results: Path, _jobs: int) -> Iterator[Examined]:
        assert (cases.parent / "answers.json").exists()
        assert any(digest in line for line in said for digest in [sealed(cases)])
        for case in sorted(cases.iterdir()):
            if (results / f"{case.name}.json").exists():
                continue
            assert "before_1.csv" in words_for(case)
            asked.append(case.name)
            if len(asked) == 10:
                raise KeyboardInterrupt
            (results / f"{case.name}.json").write_text(json.dumps({"findings": []}))
            yield Examined(case.name, "", 2.0)

    def sealed(cases: Path) -> str:
        return (cases.parent / "answers.json.sha256").read_text().strip()

    desk = Desk(say=said.append, workers=ThreadPoolExecutor, ask=ask)
    with pytest.raises(KeyboardInterrupt):
        prove_changes(out, 1, 12, desk)
    so_far = json.loads((out / "figures.json").read_text())
    assert len(so_far["lines"]) == 8, "a batch that is done is counted"
    assert so_far["figures"]["false_alarm"]["hits"] == 0
    assert so_far["figures"]["false_alarm"]["cases"] == 4
    answers = out / "batch_002" / "answers.json"
    before = answers.read_bytes()
    content = prove_changes(out, 1, 12, desk)
    assert answers.read_bytes() == before
    assert len(asked) == 13, "what was answered is not asked again"
    assert [one["answer"]["seed"] for one in content["lines"]] == [1001000 + k for k in range(12)]
    assert content == json.loads((out / "figures.json").read_text())
    kept = {path.name for path in out.glob("batch_*/cases/*")}
    assert kept == {one["id"] for one in content["lines"] if one["answer"]["change"]}
    with pytest.raises(InputError, match="holds another proof"):
        prove_changes(out, 2, 12, desk)
    with pytest.raises(InputError, match="is not empty"):
        prove_changes(tmp_path, 1, 12, desk)
    with pytest.raises(InputError, match="--out: cannot be made"):
        prove_changes(answers / "none", 1, 12, desk)
    (out / "batch_002" / "lines.jsonl").unlink()
    answers.write_text(answers.read_text().replace('"seed": 1001008', '"seed": 1001009'))
    with pytest.raises(InputError, match="seal is broken"):
        prove_changes(out, 1, 12, desk)


def line(change: str, shared: str, told: list[str] | None, right: bool) -> dict[str, Any]:
    """A judged case; wrong names are those of the catalogue that are not right."""
    false = [] if right or told is None else told
    return {
        "answer": {"change": change, "shared": shared},
        "told": told,
        "right": right,
        "false": false,
    }


def test_figures_tell_alarms_from_silence_and_what_is_shared() -> None:
    found = figures([
        line("stribeck", "", ["stribeck new"], True),
        line("stribeck", "", [], False),
        line("stribeck", "eddy", ["inertia new"], False),
        line("", "", [], True),
        line("", "eddy", ["unknown new"], False),
        line("", "eddy", None, False),
    ])  # fmt: skip
    counted = {name: (one["hits"], one["cases"]) for name, one in found.items()}
    assert counted["right_name"] == (1, 3)
    assert counted["right_name_alone"] == (1, 2)
    assert counted["wrong_name"] == (1, 3)
    assert counted["wrong_name_beside_shared"] == (1, 1)
    assert counted["false_alarm"] == (1, 3)
    assert counted["false_alarm_beside_shared"] == (1, 2)
    assert counted["no_answer"] == (1, 6)
