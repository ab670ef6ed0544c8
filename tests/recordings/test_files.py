"""Where files are written: whole in the place of another, or into what is no file."""

import json
import os
import threading
from pathlib import Path

import pytest

from eps_hil.cli.main import main
from eps_hil.errors import EpsHilError
from eps_hil.recordings.files import check_writable, replacing

MODEL = str(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")


def test_a_pipe_is_written_into_and_stays_one(tmp_path: Path) -> None:
    """So does /dev/null: as root it became a file."""
    pipe, heard = tmp_path / "pipe.json", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: heard.append(pipe.read_text()), daemon=True)
    reader.start()
    check_writable(pipe)
    with replacing(pipe) as temporary:
        temporary.write_text("told")
    reader.join(10.0)
    assert heard == ["told"]
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]


def test_of_a_failure_a_pipe_hears_nothing(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.json"
    os.mkfifo(pipe)
    with pytest.raises(EpsHilError, match="not today"), replacing(pipe):  # would wait for a reader
        raise EpsHilError("not today")


def test_json_goes_to_a_pipe_by_its_number(capsys: pytest.CaptureFixture[str]) -> None:
    """As of ``--json /dev/stdout`` or ``--json >(jq .)``."""
    reading, writing = os.pipe()
    assert main(["check", MODEL, "--json", f"/dev/fd/{writing}"]) == 0
    os.close(writing)
    with os.fdopen(reading) as told:
        assert json.load(told)["schema"] == "eps-hil/check/1"
    assert capsys.readouterr().err == ""


def test_a_dash_is_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["check", MODEL, "--json", "-"]) == 2
    said = capsys.readouterr().err
    assert said == "eps-hil: -: is no file name; standard output is /dev/stdout\n"
    assert list(tmp_path.iterdir()) == []
