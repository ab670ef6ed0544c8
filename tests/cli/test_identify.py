"""The verb: model file, JSON, page, and one line for what is wrong."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from eps_hil.cli.main import main
from eps_hil.physics.model import load_model
from eps_hil.proof import manoeuvres, sensors
from eps_hil.proof.world import Instruments, World

MODEL = str(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")


def written(path: Path, columns: Mapping[str, Any]) -> Path:
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return path


@pytest.fixture(scope="module")
def columns() -> dict[str, Any]:
    rng = np.random.default_rng(8)
    truth = World(simple=True).run(manoeuvres.constant_speed(rng, 24.0))
    return sensors.measured(sensors.reported(truth, Instruments()), Instruments(), rng)


def test_model_json_and_page(
    tmp_path: Path, columns: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    recording = written(tmp_path / "speeds.csv", columns)
    out, page, model = tmp_path / "found.json", tmp_path / "page.html", tmp_path / "rig.yaml"
    words = ["identify", str(recording), "--model", MODEL, "--write-model", str(model)]
    assert main([*words, "--json", str(out), "--report", str(page)]) == 0
    content = json.loads(out.read_text())
    assert content["schema"] == "eps-hil/identification/1"
    offset = content["parameters"]["friction"]["offset_pos_nm"]
    assert offset["status"] == "identified"
    assert offset["value"] == pytest.approx(0.056, rel=0.05)
    assert offset["from_model"] == 0.056
    assert offset["ci95"][0] < offset["value"] < offset["ci95"][1]
    assert content["coverage"]["lacking"]
    rig = load_model(model)
    assert rig.friction.offset_pos_nm == pytest.approx(offset["value"])
    whole = yaml.safe_load(model.read_text())
    assert whole["provenance"]["parameters"]["friction.offset_pos_nm"]["old_value"] == 0.056
    assert len(whole["friction_map"]) == len(content["friction_map"])
    html = page.read_text()
    assert "<svg" in html
    assert "friction.offset_pos_nm" in html
    assert "http" not in html.split("</style>")[1].replace("http://www.w3.org", "").split("<svg")[0]
    said = capsys.readouterr()
    assert "friction.offset_pos_nm" in said.out
    assert said.err == ""


def test_swapped_columns_end_with_status_2(
    tmp_path: Path, columns: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    swapped = {
        **columns,
        "motor_torque_nm": columns["torque_sensor_nm"],
        "torque_sensor_nm": columns["motor_torque_nm"],
    }
    recording = written(tmp_path / "speeds.csv", swapped)
    assert main(["identify", str(recording), "--model", MODEL]) == 2
    said = capsys.readouterr()
    assert len(said.err.splitlines()) == 1
    assert "speeds.csv: torque_sensor_nm" in said.err
    assert "swapped" in said.err


@pytest.mark.parametrize("option", ["--write-model", "--report"])
def test_what_an_fmu_cannot_give_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    """It was left out, with status 0."""
    (tmp_path / "s.fmu").write_bytes(b"")
    given = ["identify", "--model", MODEL, str(tmp_path / "r.csv")]
    given += ["--simulation", str(tmp_path / "s.fmu"), option, str(tmp_path / "out")]
    assert main(given) == 2
    assert f"{option}: does not go with --simulation" in capsys.readouterr().err


def test_a_recording_of_two_rows_is_told_how_much_is_needed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = tmp_path / "short.csv"
    recording.write_text("time_s,motor_torque_nm,motor_speed_rad_s\n0,1,2\n0.001,1,2\n")
    assert main(["identify", str(recording), "--model", MODEL]) == 2
    said = capsys.readouterr().err
    assert "motor_torque_nm: has only 2 values; record 3 s or more" in said
    assert said.count("\n") == 1
