"""``eps-hil tune`` as a user calls it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.cli.main import main

ROOT = Path(__file__).parents[2]
MODEL = str(ROOT / "configs" / "reference_rig.yaml")
NAMES = ("time_s", "motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s")


def write_csv(path: Path, columns: Any, rows: int = 10_000) -> Path:
    table = np.column_stack([columns[name][:rows] for name in NAMES])
    np.savetxt(path, table, delimiter=",", header=",".join(NAMES), comments="", fmt="%.9g")
    return path


def test_curve_table_json_figure_and_advice(
    tmp_path: Path, steps_truth: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_csv(tmp_path / "steps.csv", steps_truth.columns)
    result, figure = tmp_path / "t.json", tmp_path / "t.png"
    words = ["tune", "--model", MODEL, "--recording", str(recording), "--json", str(result)]
    assert main([*words, "--figure", str(figure)]) == 0
    said = capsys.readouterr().out
    assert "rest in the recording" in said
    assert "Now: " in said
    found = json.loads(result.read_text(encoding="utf-8"))
    assert found["schema"] == "eps-hil/tune/1"
    assert found["noise"]["speed_rad_s"] == pytest.approx(0.3, rel=0.05)
    assert found["now"]["simulated_noise_n"] == pytest.approx(found["now"]["noise_n"], rel=0.2)
    assert len(found["curve"]) == 25
    assert figure.stat().st_size > 10_000


def test_a_recording_without_a_rest_is_refused(
    tmp_path: Path, steps_truth: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    columns = dict(steps_truth.columns)
    columns["motor_speed_rad_s"] = columns["motor_speed_rad_s"] + 30.0
    recording = write_csv(tmp_path / "fast.csv", columns)
    assert main(["tune", "--model", MODEL, "--recording", str(recording)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "no rest" in err


def test_settings_that_have_no_such_curve(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = tmp_path / "s.yaml"
    settings.write_text("quantity: friction\n", encoding="utf-8")
    assert main(["tune", "--model", MODEL, "--settings", str(settings)]) == 2
    assert "quantity" in capsys.readouterr().err
