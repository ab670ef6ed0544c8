"""What needs an extra that is not installed is refused first, before any file is even opened."""

import importlib.util
import tomllib
from pathlib import Path

import pytest

from eps_hil.cli.main import main
from eps_hil.dashboard import server

ROOT = Path(__file__).parents[2]
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
    "asammdf": [
        ["diagnose", "--recording", "a.csv", "--holdout", "not_there.mf4", *MODEL],
        ["replay", "not_there.mf4"],
        ["replay", "not_there.mf4", "--commands", "--config", "not_there.yaml"],
        ["golden", "make", "not_there.mf4", "--config", "not_there.yaml", "--out", "g.csv"],
        ["golden", "check", "not_there.csv", "--log", "not_there.mf4"],
    ],
    "distributed": [["batch", "estimate", "there", *MODEL, "--out", "o", "--dask", "tcp://b:1"]],
}


def without(monkeypatch: pytest.MonkeyPatch, *libraries: str) -> None:
    there = importlib.util.find_spec

    def find(name: str, *rest: str) -> object:
        return None if name in libraries else there(name, *rest)

    monkeypatch.setattr(importlib.util, "find_spec", find)


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
    without(monkeypatch, library)
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    said = capsys.readouterr().err
    assert 'extra; pip install "eps_hil[' in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_batch_names_all_extras_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    without(monkeypatch, "pyarrow", "matplotlib")
    assert main(["batch", "estimate", "not_there", *MODEL, "--out", str(tmp_path / "o")]) == 2
    assert 'pip install "eps_hil[parquet,report]"' in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["calibrate", "torque-injection"], ["replay", "not_there.log", "--commands"]]
)
def test_an_e2e_profile_asks_for_its_extra_before_a_torque_is_planned(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    without(monkeypatch, "e2e")
    text = (ROOT / "configs" / "calibrate_udp.yaml").read_text()
    text = text.replace("../dbc", f"{ROOT}/dbc").replace(" eps_rig_", f" {ROOT}/configs/eps_rig_")
    text = text.replace(" reference_rig", f" {ROOT}/configs/reference_rig")
    text = text.replace("\noverride:\n", "\noverride:\n  e2e: {profile: p01, data_id: 128}\n")
    config = tmp_path / "c.yaml"
    config.write_text(text)
    assert main([*words, "--config", str(config)]) == 2
    said = capsys.readouterr().err
    assert "override.e2e: an AUTOSAR profile needs the 'e2e' extra; pip install \"eps_hil[" in said
    assert said.count("\n") == 1


def test_the_dashboards_extra_brings_all_that_it_asks_for() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extra = {line.split(">")[0] for line in project["optional-dependencies"]["dashboard"]}
    assert extra == {"uplot-python" if name == "uplot" else name for name in server.LIBRARIES}


def test_what_an_investigation_lacks_is_not_called_an_option(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nobody said --report."""
    without(monkeypatch, "jinja2")
    assert main(["investigate", "--config", "not_there.yaml", "--budget", "1min"]) == 2
    assert capsys.readouterr().err.startswith("eps-hil: investigate: a page needs")


@pytest.mark.parametrize("words", WITHOUT["matplotlib"][:4])
def test_a_figure_that_cannot_be_written_is_refused_first(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words[:-1], "f.docx"]) == 2
    assert "not a kind of figure" in capsys.readouterr().err
    assert main([*words[:-1], "no/folder/f.png"]) == 2
    assert "does not exist" in capsys.readouterr().err
