"""JSON of unknown origin, and the verbs that are given some."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from eps_hil import json_text
from eps_hil.cli.main import main
from eps_hil.dashboard.marks import Marks
from eps_hil.errors import InputError
from eps_hil.fmu.traces import read_values
from eps_hil.service.journal import level_changes

ROOT = Path(__file__).parents[1]


def test_what_is_read_is_what_stands_there() -> None:
    assert json_text.parse('{"a": [1, {"b": null}]}') == {"a": [1, {"b": None}]}
    assert json_text.parse(b"3") == 3
    assert json_text.parse('{"a": 1, "a": 2}', pairs=list) == [("a", 1), ("a", 2)]
    assert json_text.parse("[" * 100 + "]" * 100)


@pytest.mark.parametrize(
    "text",
    ["[" * 101 + "]" * 101, "[" * 100_000, '{"a": ' * 500 + "1" + "}" * 500, "[", "9" * 5000],
)
def test_what_is_not_read_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError, match=r"nested deeper than 100 levels|Expecting|Exceeds"):
        json_text.parse(text)


def test_a_number_that_does_not_exist_is_null() -> None:
    told = {1: [math.nan, (math.inf, 2.5, True)], "a": {"b": -math.inf, "c": None}}
    assert json_text.plain(told) == {"1": [None, [None, 2.5, True]], "a": {"b": None, "c": None}}


def test_a_verb_names_the_file_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    deep = tmp_path / "deep.json"
    deep.write_text("[" * 5000 + "]" * 5000)
    model = str(ROOT / "configs" / "reference_rig.yaml")
    assert main(["budget", "--model", model, "--uncertainty", str(deep)]) == 2
    said = capsys.readouterr().err
    assert "deep.json: cannot be read as JSON: nested deeper than 100 levels; give" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    "read", [level_changes, read_values, Marks], ids=["levels", "known", "marks"]
)
def test_a_file_of_another_program_is_refused(
    read: Callable[[Path], object], tmp_path: Path
) -> None:
    deep = tmp_path / "deep.json"
    deep.write_text("[" * 5000 + "]" * 5000)
    with pytest.raises(InputError, match=r"deep\.json: "):
        read(deep)
