"""``eps-hil export``: the model as an FMU."""

import zipfile
from pathlib import Path

import pytest

from eps_hil.cli.main import main

RIG = str(Path(__file__).parents[2] / "configs/reference_rig.yaml")


def test_the_fmu_holds_source_binary_and_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "drive.fmu"
    assert main(["export", RIG, "--fmu", str(out)]) == 0
    said = capsys.readouterr()
    assert "15 parameters, 0 effects" in said.out
    assert "motor_speed 4 ms" in said.err
    names = zipfile.ZipFile(out).namelist()
    assert {"modelDescription.xml", "sources/fmi2.c", "resources/model.yaml"} <= set(names)
    assert any(name.startswith("binaries/") for name in names)


def test_fmi_3_on_request(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "drive.fmu"
    assert main(["export", RIG, "--fmu", str(out), "--fmi-version", "3"]) == 0
    assert "FMI 3.0" in capsys.readouterr().out
    names = zipfile.ZipFile(out).namelist()
    assert {"sources/fmi3.c", "sources/buildDescription.xml"} <= set(names)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["nothing.yaml", "--fmu", "a.fmu"], "nothing.yaml"),
        ([RIG, "--fmu", "a.txt"], "ends in .fmu"),
        ([RIG, "--fmu", "a.fmu", "--fmi-version", "1"], "2 or 3 was expected"),
        ([RIG, "--fmu", "nowhere/a.fmu"], "does not exist"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    words: list[str],
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["export", *words]) == 2
    said = capsys.readouterr().err
    assert expected in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())
