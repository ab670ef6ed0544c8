"""Verbs that take long on real work do a small piece of it, from words to the files they write."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
import yaml

from eps_hil.cli.main import main
from eps_hil.investigate import experiment
from eps_hil.investigate import run as investigation
from eps_hil.proof import manoeuvres, sensors
from eps_hil.proof.examine import Diagnoser, Examined
from eps_hil.proof.world import Instruments, World

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "configs" / "reference_rig.yaml"


def recorded(path: Path, seed: int, seconds: float) -> Path:
    """A rig of other code at constant speeds, as the reference model knows it."""
    rng = np.random.default_rng(seed)
    truth = World(simple=True).run(manoeuvres.constant_speed(rng, seconds))
    columns: Mapping[str, Any] = sensors.measured(
        sensors.reported(truth, Instruments()), Instruments(), rng
    )
    path.parent.mkdir(exist_ok=True)
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return path


def test_batch_estimates_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for k in (1, 2):
        recorded(tmp_path / "recordings" / f"{k}.csv", k, 3.0)
    out = tmp_path / "out"
    words = ["batch", "estimate", str(tmp_path / "recordings"), "--model", str(MODEL)]
    assert main([*words, "--out", str(out), "--processes", "1"]) == 0
    assert "2 recordings, 0 of them known before, 0 failed" in capsys.readouterr().out
    rows = pyarrow.parquet.read_table(out / "results.parquet").to_pylist()
    for row in rows:
        estimate = pyarrow.parquet.read_table(out / row["output"])
        assert 2000 < estimate.num_rows <= 3001
    assert "2 recordings of 2 units; 0 failed" in (out / "population.html").read_text()


def test_budget_of_a_short_manoeuvre(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = tmp_path / "short.yaml"
    short.write_text(
        "manoeuvre:\n  name: short\n  segments:\n    - duration_s: 2.0\n"
        "      rack_force_n: {sine: {amplitude: 800.0, frequency_hz: 1.5}}\n"
        "      driver: hands_off\n      motor: {stiffness_nm_per_rad: 0.03}\n"
    )
    sizes, result = tmp_path / "u.yaml", tmp_path / "b.json"
    sizes.write_text("uncertainty: {percent: {offset_pos_nm: 40}}\n")
    words = ["budget", "--model", str(MODEL), "--uncertainty", str(sizes), "--draws", "4"]
    assert main([*words, "--manoeuvre", str(short), "--json", str(result)]) == 0
    assert "moving: friction levels first" in capsys.readouterr().out
    found = json.loads(result.read_text())
    assert found["sources"][0]["source"] == "offset_pos_nm"
    assert found["phases"]["moving"]["total_n"] > found["phases"]["moving"]["method_n"]


def test_changes_of_a_rig_that_is_as_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = recorded(tmp_path / "before.csv", 1, 10.0)
    after = recorded(tmp_path / "after.csv", 2, 10.0)
    out, page = tmp_path / "c.json", tmp_path / "c.html"
    words = ["changes", "--before", str(before), "--after", str(after), "--model", str(MODEL)]
    assert main([*words, "--json", str(out), "--report", str(page)]) == 0
    assert capsys.readouterr().out.endswith(f"\npage: {page}\n")
    content = json.loads(out.read_text())
    assert content["schema"] == "eps-hil/diagnosis/1"
    assert content["verdict"] == content["before"]["verdict"] == "no_mismatch"
    assert content["findings"] == []
    assert "after.csv" in page.read_text()


def test_investigate_runs_one_experiment_of_its_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A short menu: foreseeing all that could be asked takes longer than the experiment."""
    rig = yaml.safe_load(MODEL.read_text())
    rig["model"]["effects"] = [{"effect": "stribeck", "level_nm": 0.05, "speed_rad_s": 6.0}]
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    config, out, story = tmp_path / "c.yaml", tmp_path / "out", tmp_path / "s.json"
    config.write_text(
        f"bus: {{interface: virtual, channel: one_experiment}}\ndbc: {ROOT}/dbc/eps_rig.dbc\n"
        f"signals: {ROOT}/configs/eps_rig_signals.yaml\nmodel: {MODEL}\n"
        "investigate: {load_n: 0, rack_travel_m: 0.02, matters: 0.1}\n"
        "rig: {manoeuvre: idle, loop: true, model: rig.yaml, order: 2, realtime: false}\n"
    )
    whole = experiment.menu
    monkeypatch.setattr(investigation, "menu", lambda *given: whole(*given)[:2])
    words = ["investigate", "--config", str(config), "--out", str(out), "--simulated"]
    assert main([*words, "--budget", "20s", "--json", str(story)]) == 0
    assert "The budget is spent" in capsys.readouterr().out
    told = json.loads(story.read_text())
    assert told["stop"] == "budget"
    assert len(told["rounds"]) == 2
    assert told["rounds"][0]["next"][0]["bits"] > 0.0
    (log,) = out.glob("step_01*.log")
    assert log.stat().st_size > 100_000
    assert "Round by round" in (out / "investigation.html").read_text()


def test_prove_concealed_says_which_kinds_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", "concealed", "--kind", "loads", "--kind", "load"]) == 2
    said = capsys.readouterr().err
    assert "--kind: load: is no kind of a proof; use singles, decoys" in said
    assert "Traceback" not in said


@pytest.mark.slow
def test_prove_concealed_hides_seals_and_judges(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The diagnosis, which takes most of a proof's time, says here that nothing is missing."""

    def ask(_diagnoser: Diagnoser, _words: object, case: Path, results: Path) -> Examined:
        said = {"verdict": "no_mismatch", "findings": []}
        (results / f"{case.name}.json").write_text(json.dumps(said))
        (results / f"{case.name}.html").write_text("the page")
        return Examined(case.name, "", 1.0)

    monkeypatch.setattr(Diagnoser, "ask", ask)
    out, result = tmp_path / "proof", tmp_path / "proof.json"
    words = ["prove", "concealed", "--development", "--seed", "3", "--cases", "1", "--jobs", "1"]
    assert main([*words, "--out", str(out), "--json", str(result)]) == 0
    said = capsys.readouterr().out
    seal = (out / "seals.txt").read_text().split()[1]
    assert said.index(seal) < said.index("seal opened") < said.index("right name first")
    (line,) = map(json.loads, (out / "cases.jsonl").read_text().splitlines())
    assert line["failed"]  # physics was hidden, and none was named
    assert (out / line["report"]).read_text() == "the page"  # a wrong case's page is kept
    force = {name: one["rack_force_rmse_n"] for name, one in line["worth"].items()}
    assert 0 < force["oracle"] < force["baseline"]
    assert json.loads(result.read_text())["cases"] == 1
    assert "1 cases" in (out / "index.html").read_text()
