"""``eps-hil compare`` on a short recording of the simulated rig: table, JSON, figure, errors."""

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from eps_hil.cli.main import main
from eps_hil.estimation import batch
from eps_hil.physics.chain_parameters import load_chain
from eps_hil.physics.model import load_model
from eps_hil.recordings.read import read_recording
from eps_hil.recordings.write import write_table
from eps_hil.report.comparison import read_published
from eps_hil.rig.manoeuvre import load_manoeuvre
from eps_hil.rig.offline import simulate_recording

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "configs" / "reference_rig.yaml"
MANOEUVRE = """
manoeuvre:
  name: short
  description: two seconds of motion, two of rest under load
  segments:
    - duration_s: 2.0
      rack_force_n: {sine: {amplitude: 750.0, frequency_hz: 2.0, fade_s: 0.5}}
      driver: hands_off
      motor: {stiffness_nm_per_rad: 0.03, damping_nm_s_per_rad: 2.0e-4}
    - duration_s: 2.0
      rack_force_n: {steps: {levels: [800.0], hold_s: 1.9, rise_s: 0.05}}
      driver: hands_off
      motor: {stiffness_nm_per_rad: 0.03, damping_nm_s_per_rad: 2.0e-3}
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compare")
    (folder / "short.yaml").write_text(MANOEUVRE, encoding="utf-8")
    made = simulate_recording(
        load_model(MODEL),
        load_chain(ROOT / "configs" / "reference_chain.yaml"),
        load_manoeuvre(folder / "short.yaml"),
    )
    write_table(folder / "short.csv", made.columns)
    return folder / "short.csv"


@pytest.fixture
def live(recording: Path, tmp_path: Path) -> Path:
    """What a service would have logged that was 30 N off throughout."""
    trace = batch.estimate(read_recording(recording).series, load_model(MODEL))
    path = tmp_path / "live.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        names = ["rack_force_estimate_n", "friction_torque_nm", "valid", "reason", "t_ns"]
        table.writerow(["time_s", *names])
        for t_ns, force, friction, reason in zip(
            trace.t_ns, trace.rack_force_n, trace.friction_torque_nm, trace.reason, strict=True
        ):
            table.writerow([t_ns * 1e-9, force + 30.0, friction, int(reason == 0), reason, t_ns])
    return path


def test_compensation_and_extensions_show_their_worth(
    recording: Path,
    live: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    words = ["compare", str(recording), "--model", str(MODEL), "--live", str(live)]
    words += ["--json", str(tmp_path / "c.json"), "--figure", str(tmp_path / "f.png")]
    assert main([*words, "--zoom", "0.5:1"]) == 0
    said, waited = capsys.readouterr()
    assert "estimating with and without" in waited
    assert "drawing" in waited
    assert "no friction compensation" in said
    assert str(tmp_path / "f.png") in said.replace("\n", "")
    content = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))
    assert content["schema"] == "eps-hil/compare/1"
    by_name = {one["estimate"]: one for one in content["estimates"]}
    assert list(by_name) == ["live", "2Q-fa", "no exten", "w/o FC"]
    full, bare = by_name["2Q-fa"], by_name["w/o FC"]
    assert full["rmse_moving_n"] < 25.0
    assert bare["rmse_moving_n"] > 200.0
    assert full["rmse_resting_n"] < by_name["no exten"]["rmse_resting_n"]
    # The same estimate, 30 N off: E(e + 30)² = E e² + 60 E e + 900, with |E e| < rms e.
    assert abs(by_name["live"]["rmse_moving_n"] - 30.0) <= full["rmse_moving_n"]
    assert (tmp_path / "f.png").read_bytes().startswith(b"\x89PNG")


def test_rms_overall_is_made_of_moving_and_resting(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "c.json"
    assert main(["compare", str(recording), "--model", str(MODEL), "--json", str(target)]) == 0
    for one in json.loads(target.read_text(encoding="utf-8"))["estimates"]:
        parts = sorted((one["rmse_moving_n"], one["rmse_resting_n"]))
        assert parts[0] <= one["rmse_overall_n"] <= parts[1]
    capsys.readouterr()


def test_a_log_of_estimates_is_read_back_exactly(recording: Path, live: Path) -> None:
    trace = batch.estimate(read_recording(recording).series, load_model(MODEL))
    read = read_published(live)
    assert np.array_equal(read.t_ns, trace.t_ns)
    assert np.array_equal(read.rack_force_n, trace.rack_force_n + 30.0)
    assert np.array_equal(read.reason, trace.reason)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "holds no estimate"),
        ("time_s,valid\n0,1\n", "rack_force_estimate_n: column is missing"),
        (
            "time_s,rack_force_estimate_n,friction_torque_nm,valid,reason,t_ns\n0,1.0,0.0,1",
            "a row is broken",
        ),
    ],
)
def test_a_broken_log_is_one_line(
    recording: Path, tmp_path: Path, text: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "live.csv"
    broken.write_text(text, encoding="utf-8")
    assert main(["compare", str(recording), "--model", str(MODEL), "--live", str(broken)]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert str(broken) in error
    assert error.count("\n") == 1


def test_a_recording_without_load_cell_is_one_line(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    series = read_recording(recording).series
    bare = tmp_path / "bare.csv"
    names = ("motor_torque_nm", "motor_speed_rad_s", "torque_sensor_nm")
    columns = {name: series[name].value for name in names}
    write_table(bare, columns, t_ns=series["motor_torque_nm"].t_ns)
    assert main(["compare", str(bare), "--model", str(MODEL)]) == 2
    error = capsys.readouterr().err
    assert "bare.csv: rack_force_n: holds no load cell to compare with" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("zoom", ["5", "2:1", "a:b", "-1:2"])
def test_a_zoom_is_a_span(recording: Path, zoom: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(recording), "--model", str(MODEL), "--zoom", zoom]) == 2
    assert "FROM:TO" in capsys.readouterr().err


@pytest.mark.slow
def test_the_second_estimator_stands_beside_the_papers(recording: Path, tmp_path: Path) -> None:
    summary, figure = tmp_path / "c.json", tmp_path / "c.png"
    words = ["compare", str(recording), "--model", str(MODEL), "--second", "--json", str(summary)]
    assert main([*words, "--figure", str(figure)]) == 0
    rows = {one["estimate"]: one for one in json.loads(summary.read_text("utf-8"))["estimates"]}
    assert list(rows) == ["2Q-fa", "no exten", "w/o FC", "bristle filter", "smoother"]
    # the start, where the filter was the better one, is not valid and not scored
    paper = rows["2Q-fa"]["rmse_moving_n"]
    assert rows["bristle filter"]["rmse_moving_n"] < 1.1 * paper
    assert rows["smoother"]["rmse_moving_n"] < paper
    assert figure.stat().st_size > 10_000
