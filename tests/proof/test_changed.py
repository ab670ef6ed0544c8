"""What changed between two states: planned evenly, hidden, sealed, judged."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.proof.changed import (
    ChangePlan,
    change_plans,
    hide,
    judge_change,
    prove_changes,
    words_for,
)
from eps_hil.proof.effects import ALIENS
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


def test_it_is_sealed_before_it_is_asked_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def hidden(plan: ChangePlan, folder: Path) -> dict[str, Any]:
        folder.mkdir(parents=True)
        (folder / "before_1.csv").write_text("x")
        return {"change": plan.change, "gone": plan.gone, "shared": plan.shared, "seed": plan.seed}

    monkeypatch.setattr("eps_hil.proof.changed.hide", hidden)
    out, asked = tmp_path / "out", []
    answers = out / "answers.json"

    def ask(words: Sequence[str], case: Path, results: Path) -> None:
        assert answers.exists()
        assert words[0] == "changes"
        assert "before_1.csv" in words
        assert {path.name for path in case.iterdir()} == {"before_1.csv"}
        asked.append(case.name)
        if len(asked) == 2:
            raise KeyboardInterrupt
        (results / f"{case.name}.json").write_text(json.dumps({"findings": []}))

    with pytest.raises(KeyboardInterrupt):
        prove_changes(out, 1, 4, ask=ask)
    sealed = answers.read_bytes()
    content = prove_changes(out, 1, 4, ask=ask)
    assert answers.read_bytes() == sealed
    assert len(asked) == 5, "what was answered is not asked again"
    assert content["figures"]["without_change_right"]["hits"] == 2
    assert content["figures"]["with_change_right"]["hits"] == 0
    with pytest.raises(InputError, match="holds another proof"):
        prove_changes(out, 2, 4, ask=ask)
    with pytest.raises(InputError, match="is not empty"):
        prove_changes(tmp_path, 1, 4, ask=ask)
    with pytest.raises(InputError, match="--out: cannot be made"):
        prove_changes(answers / "none", 1, 4, ask=ask)
    answers.write_text(answers.read_text().replace('"seed": 1001000', '"seed": 1001009'))
    with pytest.raises(InputError, match="seal is broken"):
        prove_changes(out, 1, 4, ask=ask)
