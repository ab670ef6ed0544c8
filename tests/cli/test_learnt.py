"""A model file with a law that a diagnosis wrote: every command that reads the file acts by it."""

import json
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.cli.main import main
from eps_hil.physics.model import dump_model, load_model

PLAIN = Path(__file__).parents[2] / "configs" / "reference_rig.yaml"
LAW: Mapping[str, Any] = {
    "effect": "empirical", "form": "law", "where": "load", "how": "factor",
    "inputs": ["motor_angle_rad"], "memory": ["none"], "shapes": ["linear"], "size": 0.03,
    "range": {"motor_angle_rad": [-30.0, 30.0]}, "law": "F/i_APA · (1 + 0.03 · φ)",
}  # fmt: skip


@pytest.fixture
def learnt(tmp_path: Path) -> Path:
    """The model file with the law among its effects."""
    model = load_model(PLAIN)
    path = tmp_path / "learnt.yaml"
    path.write_text(dump_model(replace(model, effects=(LAW,))), encoding="utf-8")
    return path


@pytest.fixture
def driven(tmp_path: Path) -> Path:
    """Motor torque and rack force that carry the rotor some ten radians to and fro."""
    t = np.arange(6000) * 1e-3
    force = 400.0 * np.sin(1.3 * t)
    torque = force / 2513.0 + 0.13 * np.sin(4.0 * t)
    path = tmp_path / "driven.csv"
    np.savetxt(path, np.column_stack([t, torque, force]), delimiter=",", comments="",
               header="time_s,motor_torque_nm,rack_force_n", fmt="%.9g")  # fmt: skip
    return path


def simulated(model: Path, driven: Path) -> Path:
    out = driven.parent / f"{model.stem}.csv"
    assert (
        main(["simulate", "--model", str(model), "--inputs", str(driven), "--out", str(out)]) == 0
    )
    return out


def error_n(recording: Path, model: Path) -> float:
    summary = recording.parent / "summary.json"
    assert main(["estimate", str(recording), "--model", str(model), "--json", str(summary)]) == 0
    (one,) = json.loads(summary.read_text(encoding="utf-8"))["recordings"]
    return float(one["rack_force_error_n"]["rms_moving"])


def test_simulate_and_estimate_act_by_it(learnt: Path, driven: Path) -> None:
    with_it, without = (
        np.genfromtxt(simulated(one, driven), delimiter=",", names=True) for one in (learnt, PLAIN)
    )
    assert np.std(with_it["motor_speed_rad_s"] - without["motor_speed_rad_s"]) > 1.0
    recording = driven.parent / "learnt.csv"
    assert error_n(recording, learnt) < 20.0
    assert error_n(recording, PLAIN) > 3.0 * error_n(recording, learnt)


def test_export_holds_it(learnt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "drive.fmu"
    assert main(["export", str(learnt), "--fmu", str(out)]) == 0
    assert "1 effect," in capsys.readouterr().out
    held = zipfile.ZipFile(out).read("resources/model.yaml").decode()
    assert "effect: empirical" in held
    assert "size: 0.03" in held
