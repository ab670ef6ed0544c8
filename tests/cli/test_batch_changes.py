"""``eps-hil batch changes``: two states of each of several units, from words to tables and page."""

from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from eps_hil.cli.main import main
from eps_hil.proof import manoeuvres, sensors
from eps_hil.proof.world import Instruments, World

MODEL = Path(__file__).parents[2] / "configs" / "reference_rig.yaml"


def recorded(path: Path, seed: int, torque_gain: float = 1.0) -> None:
    """A rig of other code at constant speeds; its ECU reports so many times the torque."""
    rng = np.random.default_rng(seed)
    truth = World(simple=True).run(manoeuvres.constant_speed(rng, 10.0))
    columns = dict(sensors.measured(sensors.reported(truth, Instruments()), Instruments(), rng))
    columns["motor_torque_nm"] = torque_gain * columns["motor_torque_nm"]
    path.parent.mkdir(parents=True, exist_ok=True)
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")


@pytest.mark.slow
def test_units_that_changed_and_that_did_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rigs, out = tmp_path / "rigs", tmp_path / "out"
    for seed, unit in enumerate(("as_it_was", "drifted", "half")):
        recorded(rigs / unit / "before" / "monday.csv", 2 * seed + 1)
        if unit != "half":
            gain = 0.9 if unit == "drifted" else 1.0
            recorded(rigs / unit / "after" / "friday.csv", 2 * seed + 2, gain)
    words = ["batch", "changes", str(rigs), "--model", str(MODEL), "--out", str(out)]
    assert main([*words, "--processes", "1"]) == 0
    said = capsys.readouterr()
    assert "3 units, 0 of them known before, 1 failed" in said.out
    assert "half: " in said.err
    assert "no recording of the state after; put some below half/after" in said.err

    results = pyarrow.parquet.read_table(out / "results.parquet").to_pylist()
    assert [(row["unit"], row["state"]) for row in results] == [
        ("as_it_was", "done"), ("drifted", "done"), ("half", "failed"),
    ]  # fmt: skip
    assert results[1]["recordings_before"].endswith("drifted/before/monday.csv")
    assert all((out / row["output"]).is_file() for row in results[:2])
    changes = pyarrow.parquet.read_table(out / "changes.parquet").to_pylist()
    assert [one["change"] for one in changes if one["unit"] == "as_it_was"] == ["nothing"]
    (gain,) = [one for one in changes if one["effect"] == "motor_torque_gain"]
    assert gain["unit"] == "drifted"
    assert gain["after"] / gain["before"] == pytest.approx(1 / 0.9, rel=0.03)
    low, high = (gain["after_low"], gain["after_high"])
    assert low < gain["after"] < high
    assert gain["holdout_gain"] > 0.3
    page = (out / "population.html").read_text()
    assert "3 units in two states; 1 failed" in page
    assert "in 1 of 2 units: as_it_was." in page
    assert "motor_torque_gain" in page

    assert main(words) == 0
    assert "3 units, 3 of them known before, 1 failed" in capsys.readouterr().out
