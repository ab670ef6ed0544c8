"""NaN and infinity are refused by every option that takes a number."""

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from eps_hil.cli.main import app, main

CONFIG = Path(__file__).parents[2] / "configs" / "demo_udp.yaml"


def verbs(group: Any) -> Iterator[Any]:
    for one in group.registered_commands:
        yield one.callback
    for one in group.registered_groups:
        yield from verbs(one.typer_instance)


FLOATS = [
    (verb, name)
    for verb in verbs(app)
    for name, one in inspect.signature(verb, eval_str=True).parameters.items()
    if "float" in str(getattr(one.annotation, "__origin__", one.annotation))
]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize(("verb", "name"), FLOATS, ids=lambda each: getattr(each, "__name__", each))
def test_no_option_takes_what_is_no_number(verb: Any, name: str, value: float) -> None:
    with pytest.raises(typer.BadParameter, match="is not a finite number"):
        verb(**{name: value})


def test_options_that_take_numbers_were_found() -> None:
    assert len(FLOATS) > 20


@pytest.mark.parametrize("option", ["--alarm-moving", "--alarm-after", "--seconds"])
@pytest.mark.parametrize("value", ["nan", "inf", "1e999"])
def test_monitor_refuses_it_in_one_line(
    option: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["monitor", "--config", str(CONFIG), "--once", option, value]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert option in said
    if value != "nan":  # a range refuses NaN with some versions of typer, before we can
        assert "is not a finite number; see eps-hil" in said


@pytest.mark.parametrize("span", ["0:inf", "nan:1", "0:nan"])
def test_a_zoom_ends_somewhere(span: str, capsys: pytest.CaptureFixture[str]) -> None:
    model = str(CONFIG.parent / "reference_rig.yaml")
    assert main(["compare", "x.csv", "--model", model, "--zoom", span]) == 2
    assert f"'{span}' is not FROM:TO in seconds" in capsys.readouterr().err
