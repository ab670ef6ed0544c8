"""The frames of a case hold the recording: read back by the project's own reader."""

from pathlib import Path

import numpy as np
import pytest

from eps_hil.bus.database import load_database
from eps_hil.proof.can_log import Wire, write_log
from eps_hil.proof.cases import Case
from eps_hil.proof.examine import arguments, open_cases
from eps_hil.proof.sensors import SENSORS
from eps_hil.proof.truth import Floats
from eps_hil.proof.write import DATABASE, MAPPING, write_can_case
from eps_hil.recordings.read import read_recording

DBC = Path(__file__).parents[2] / "dbc" / "eps_rig.dbc"
SIGNALS = Path(__file__).parents[2] / "configs" / "eps_rig_signals.yaml"


def _short(case: Case, n: int = 4000) -> dict[str, Floats]:
    return {name: column[5000 : 5000 + n] for name, column in case.recordings["train_1"].items()}


def test_values_and_instants_survive_the_bus(tmp_path: Path, decoy_case: Case) -> None:
    columns = _short(decoy_case)
    log = tmp_path / "drive.log"
    lost = write_log(log, columns, load_database([DBC]), Wire(), np.random.default_rng(1))
    assert lost == 0
    recording = read_recording(log, dbc=[DBC], signals=SIGNALS)
    for name, series in recording.series.items():
        assert len(series.value) == len(columns["time_s"])
        assert np.abs(series.value - columns[name]).max() < 0.6 * SENSORS[name].step
        steps = np.diff(series.t_ns[200:])  # jitter taken out by the message counter
        assert np.abs(steps - 1_000_000).max() < 20_000
    assert set(recording.series) == set(columns) - {"time_s"}


def test_lost_frames_are_really_missing(tmp_path: Path, decoy_case: Case) -> None:
    columns = _short(decoy_case)
    log = tmp_path / "drive.log"
    wire = Wire(lost_per_frame=0.01)
    lost = write_log(log, columns, load_database([DBC]), wire, np.random.default_rng(1))
    assert lost == pytest.approx(0.01 * 3 * 4000, rel=0.5)
    assert len(log.read_text().splitlines()) == 3 * 4000 - lost


def test_a_can_case_is_complete(tmp_path: Path, decoy_case: Case) -> None:
    short = Case(
        {name: _short(decoy_case, 500) for name in ("train_1", "holdout")},
        {"seed": 1},
        np.zeros(1),
        "",
        decoy_case.nominal,
    )
    write_can_case(tmp_path / "ab", short)
    names = sorted(path.name for path in (tmp_path / "ab").iterdir())
    assert names == ["holdout.log", "model.yaml", DATABASE, MAPPING, "train_1.log"]
    given = " ".join(arguments(names))
    assert "--recording train_1.log" in given
    assert "--holdout holdout.log" in given
    assert f"--dbc {DATABASE} --gaps mark" in given
    assert f"--signals {MAPPING}" in given


def test_an_examination_goes_on_where_it_stopped(tmp_path: Path) -> None:
    for id in ("bb", "aa", "cc"):
        (tmp_path / "cases" / id).mkdir(parents=True)
        (tmp_path / "cases" / id / "model.yaml").touch()
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "bb.json").touch()
    left = open_cases(tmp_path / "cases", tmp_path / "results")
    assert [folder.name for folder in left] == ["aa", "cc"]
