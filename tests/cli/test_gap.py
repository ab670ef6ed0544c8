"""``estimate`` and ``compare`` on a recording that spans a gap of more than a second."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.cli.main import main
from eps_hil.recordings.write import write_table

ROOT = Path(__file__).parents[2]
MODEL = str(ROOT / "configs" / "reference_rig.yaml")


@pytest.fixture
def holed(tmp_path: Path, weave_truth: Any) -> Path:
    columns = weave_truth.columns
    keep = (columns["time_s"] < 4.0) | (columns["time_s"] > 6.5)
    write_table(tmp_path / "gap.csv", {name: value[keep] for name, value in columns.items()})
    return tmp_path / "gap.csv"


def column(path: Path, name: str) -> Any:
    with path.open(encoding="utf-8", newline="") as file:
        return np.array([float(row[name]) for row in csv.DictReader(file)])


def test_estimate_goes_on_after_a_gap(
    holed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was 0 N and valid from the gap on."""
    out, told = tmp_path / "out.csv", tmp_path / "told.json"
    words = ["estimate", str(holed), "--model", MODEL, "--out", str(out), "--json", str(told)]
    assert main(words) == 0
    time_s, valid = column(out, "time_s"), column(out, "valid") == 1
    assert not valid[(time_s > 4.05) & (time_s < 6.4)].any()
    late = valid & (time_s > 8.0)
    assert np.count_nonzero(late) > 20_000
    force = np.interp(time_s[late], column(holed, "time_s"), column(holed, "rack_force_n"))
    error = column(out, "rack_force_estimate_n")[late] - force
    assert np.sqrt(np.mean(error**2)) < 0.2 * np.sqrt(np.mean(force**2))
    assert '"time"' in told.read_text(encoding="utf-8")
    capsys.readouterr()


def test_compare_goes_on_after_a_gap(
    holed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = tmp_path / "told.json"
    assert main(["compare", str(holed), "--model", MODEL, "--json", str(told)]) == 0
    by_name = {e["estimate"]: e for e in json.loads(told.read_text(encoding="utf-8"))["estimates"]}
    assert by_name["2Q-fa"]["rmse_moving_n"] < 50.0
    capsys.readouterr()
