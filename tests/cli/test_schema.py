"""``--schema`` of the verbs: what their YAML files hold, for editors."""

import json
from typing import Any

import pytest

from eps_hil.cli._schema import KINDS, schema
from eps_hil.cli.main import app, main


def verbs(group: Any = app, words: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], Any]]:
    """Every verb with the words that call it."""
    found = [
        ((*words, one.name or one.callback.__name__), one.callback)
        for one in group.registered_commands
    ]
    for one in group.registered_groups:
        name = one.name if isinstance(one.name, str) else one.typer_instance.info.name
        found += verbs(one.typer_instance, (*words, name))
    return found


TAKES = [(words, verb._schema_kinds) for words, verb in verbs() if hasattr(verb, "_schema_kinds")]


@pytest.mark.parametrize(("words", "kinds"), TAKES, ids=" ".join)
def test_a_verb_prints_the_schema_of_what_it_takes(
    words: tuple[str, ...], kinds: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "--schema"]) == 0
    assert json.loads(capsys.readouterr().out) == schema(kinds[0])


def test_every_kind_of_file_has_one() -> None:
    assert {kind for _, kinds in TAKES for kind in kinds} == set(KINDS.values())
    assert len(TAKES) > 20
    for kind in KINDS.values():
        assert schema(kind)["properties"]


def test_another_kind_is_refused_and_says_which_there_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["rig", "--schema", "model"]) == 2
    assert "one of config, manoeuvre; see eps-hil rig --help" in capsys.readouterr().err
