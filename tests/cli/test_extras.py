"""What needs an extra that is not installed is refused first, before any file is even opened."""

import importlib.util
from pathlib import Path

import pytest

from eps_hil.cli.main import main

MODEL = ["--model", "not_there.yaml"]
WITHOUT = {
    "matplotlib": [
        ["compare", "not_there.csv", *MODEL, "--figure", "f.png"],
        ["tune", *MODEL, "--figure", "f.png"],
        ["frequency-response", "not_there.csv", *MODEL, "--out", "f.png"],
        ["budget", *MODEL, "--figure", "f.png"],
        ["budget", *MODEL, "--report", "f.html"],
        ["identify", "not_there.csv", *MODEL, "--report", "f.html"],
        ["reproduce", "--quick"],
        ["prove", "concealed", "--quick"],
    ],
    "jinja2": [["diagnose", "--recording", "not_there.csv", *MODEL, "--report", "f.html"]],
    "uplot": [["diagnose", "--recording", "not_there.csv", *MODEL, "--report", "f.html"]],
    "pyarrow": [
        ["estimate", "not_there.csv", *MODEL, "--out", "f.parquet"],
        ["simulate", "--inputs", "not_there.csv", *MODEL, "--out", "f.parquet"],
        ["convert", "not_there.csv", "f.parquet"],
        ["identify", "not_there.csv", "not_there.parquet", *MODEL],
    ],
    "fmpy": [
        ["diagnose", "--recording", "not_there.csv", "--simulation", "a.fmu", *MODEL],
        ["identify", "not_there.csv", "--simulation", "a.fmu", "--free", "b", *MODEL],
    ],
    "asammdf": [["diagnose", "--recording", "a.csv", "--holdout", "not_there.mf4", *MODEL]],
}


@pytest.mark.parametrize(
    ("library", "words"), [(library, words) for library, all_ in WITHOUT.items() for words in all_]
)
def test_the_extra_is_named_before_anything_else(
    library: str,
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    there = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == library else there(name)
    )
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    said = capsys.readouterr().err
    assert 'extra; pip install "eps_hil[' in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", WITHOUT["matplotlib"][:4])
def test_a_figure_that_cannot_be_written_is_refused_first(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words[:-1], "f.docx"]) == 2
    assert "not a kind of figure" in capsys.readouterr().err
    assert main([*words[:-1], "no/folder/f.png"]) == 2
    assert "does not exist" in capsys.readouterr().err
