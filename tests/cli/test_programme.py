"""What ``eps-hil programme`` makes of its cells, without a rig."""

from pathlib import Path
from typing import Any

import pytest

from eps_hil.cli.main import main
from eps_hil.identification.constant_speed import Cell
from eps_hil.physics.model import load_model
from eps_hil.programme.cell_record import CellResult
from eps_hil.programme.plan import load_plan
from eps_hil.programme.run import ProgrammeRun, Summary

ROOT = Path(__file__).parents[2]
MODEL = load_model(ROOT / "configs" / "reference_rig.yaml")
PLAN = """programme:
  name: small
  speeds_rad_s: [10.0, 40.0]
  preloads_n: [0.0, 1000.0]
"""
CONFIG = f"""\
bus: {{interface: virtual, channel: programme_cli}}
dbc: [{ROOT / "dbc" / "eps_rig.dbc"}]
signals: {ROOT / "configs" / "eps_rig_signals.yaml"}
model: {ROOT / "configs" / "reference_rig.yaml"}
"""


def ran(folder: Path, monkeypatch: pytest.MonkeyPatch, problems: tuple[str, ...]) -> list[str]:
    """Words for a programme whose cells all ended so; no rig is led."""
    (folder / "plan.yaml").write_text(PLAN)
    (folder / "c.yaml").write_text(CONFIG)
    friction, results = MODEL.friction, []
    for cell in load_plan(folder / "plan.yaml", MODEL).cells():
        level = (
            friction.offset_pos_nm + 40e-6 * cell.preload_n
            if cell.speed_rad_s > 0
            else -friction.offset_neg_nm - 40e-6 * cell.preload_n
        )
        found = Cell(cell.speed_rad_s, cell.preload_n, cell.speed_rad_s, cell.preload_n, level)
        results.append(CellResult(cell, found, 400, 0, 1, problems))
    summary = Summary(results, 0)

    def run(*_: Any, **__: Any) -> Summary:
        return summary

    monkeypatch.setattr(ProgrammeRun, "run", run)
    words = ["programme", str(folder / "plan.yaml"), "--config", str(folder / "c.yaml")]
    return [*words, "--out", str(folder / "out"), "--cells-only"]


def test_results_are_written_before_anything_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader that went away (``| head``) took the model with it."""
    words = ran(tmp_path, monkeypatch, ())
    out, json = tmp_path / "m.yaml", tmp_path / "r.json"

    def gone(*_: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("eps_hil.cli.programme._say", gone)
    assert main([*words, "--write-model", str(out), "--json", str(json)]) == 1
    assert load_model(out).friction.offset_pos_nm == pytest.approx(0.056, rel=0.05)
    assert "friction" in json.read_text()


def test_without_a_good_cell_it_is_not_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ran(tmp_path, monkeypatch, ("40 frames lost",))
    assert main(words) == 1
    said = capsys.readouterr()
    assert "no cell of 16 may be used" in said.err
    assert (tmp_path / "out" / "cells.csv").exists()


@pytest.mark.parametrize("option", ["--json", "--write-model"])
def test_nothing_that_it_reads_is_written_over(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    option: str,
) -> None:
    """A result took the place of the configuration's model file."""
    words = ran(tmp_path, monkeypatch, ())
    model = tmp_path / "own.yaml"
    model.write_text((ROOT / "configs" / "reference_rig.yaml").read_text())
    line = f"model: {ROOT / 'configs' / 'reference_rig.yaml'}"
    (tmp_path / "c.yaml").write_text(CONFIG.replace(line, f"model: {model}"))
    before = model.read_text()
    assert main([*words, option, str(model)]) == 2
    assert "own.yaml: is read by this command" in capsys.readouterr().err
    assert model.read_text() == before


@pytest.mark.parametrize("verb", ["programme", "investigate"])
@pytest.mark.parametrize("name", ["rack_force_n", "torque_sensor_nm"])
def test_a_rig_is_not_led_by_what_counts_a_twentieth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, verb: str
) -> None:
    """No preload and no torque in the torsion bar would end a cell."""
    signals, config = tmp_path / "signals.yaml", tmp_path / "c.yaml"
    mapped = (ROOT / "configs" / "eps_rig_signals.yaml").read_text()
    signals.write_text(mapped.replace(f"{name}: {{", f"{name}: {{scale: 0.05, "))
    line = f"signals: {ROOT / 'configs' / 'eps_rig_signals.yaml'}"
    assert line in CONFIG
    config.write_text(CONFIG.replace(line, f"signals: {signals}"))
    plan = [str(ROOT / "configs" / "programmes" / "friction_map.yaml")]
    words = plan if verb == "programme" else ["--budget", "1min"]
    words = [verb, *words, "--config", str(config), "--out", str(tmp_path / "out")]
    assert main(words) == 2
    assert f"signals.{name}: " in (said := capsys.readouterr().err)
    assert "scale is 0.05" in said
