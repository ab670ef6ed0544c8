"""A sealed answer cannot be changed unnoticed, and an id says nothing."""

import json
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.errors import InputError
from eps_hil.proof.seal import digest, opaque_id, open_answers, seal

CASES = {"0a1b2c": {"effects": [{"effect": "stribeck", "level_nm": 0.04}], "decoy": ""}}


def test_opens_what_was_sealed(tmp_path: Path) -> None:
    value = seal(tmp_path / "answers.json", CASES)
    assert open_answers(tmp_path / "answers.json") == CASES
    assert open_answers(tmp_path / "answers.json", value) == CASES


@pytest.mark.parametrize(("old", "new"), [("0.04", "0.05"), ("stri", "stra"), ("0a1b", "0a1c")])
def test_a_changed_answer_is_noticed(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "answers.json"
    seal(path, CASES)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match="seal is broken"):
        open_answers(path)


def test_a_changed_salt_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "answers.json"
    seal(path, CASES)
    content = json.loads(path.read_text())
    content["salt"] = "0" * 32
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="seal is broken"):
        open_answers(path)


def test_answers_sealed_anew_do_not_pass_for_those_that_were_published(tmp_path: Path) -> None:
    path = tmp_path / "answers.json"
    published = seal(path, CASES)
    seal(path, {"0a1b2c": {"effects": [], "decoy": "nothing"}})
    open_answers(path)  # the hash beside the file was forged with it
    with pytest.raises(InputError, match="published"):
        open_answers(path, published)


def test_equal_answers_have_seals_of_their_own(tmp_path: Path) -> None:
    assert seal(tmp_path / "a.json", CASES) != seal(tmp_path / "b.json", CASES)


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"salt": 1}'])
def test_a_file_that_is_no_answer_is_said_to_be_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "answers.json").write_text(text)
    (tmp_path / "answers.json.sha256").write_text("0")
    with pytest.raises(InputError, match="sealed answers"):
        open_answers(tmp_path / "answers.json")


def test_missing_answers_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"answers\.json"):
        open_answers(tmp_path / "answers.json")


@given(st.dictionaries(st.text(max_size=5), st.integers() | st.text(max_size=5), max_size=4))
def test_the_order_of_keys_is_no_part_of_the_seal(case: dict[str, int | str]) -> None:
    turned = dict(reversed(list(case.items())))
    assert digest("s", {"a": case}) == digest("s", {"a": turned})
    assert digest("s", {"a": case}) != digest("t", {"a": case})


def test_ids_are_random_and_of_one_form() -> None:
    ids = [opaque_id() for _ in range(200)]
    assert len(set(ids)) == 200
    assert {len(id) for id in ids} == {12}
    assert sum(a < b for a, b in pairwise(ids)) in range(60, 140)
