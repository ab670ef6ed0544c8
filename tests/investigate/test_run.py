"""Whole investigations on a simulated rig in lock-step: found, told, resumed, ended by limits."""

import html
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from eps_hil.bus.config import load_bus_setup
from eps_hil.cli.investigate import seconds
from eps_hil.cli.main import main
from eps_hil.errors import EpsHilError, InputError, SafetyStop
from eps_hil.investigate import story
from eps_hil.investigate.decide import Stop
from eps_hil.investigate.journal import Journal
from eps_hil.investigate.lockstep import LockstepRig
from eps_hil.investigate.possible import Menu
from eps_hil.investigate.run import (
    InterruptedInvestigationError,
    Investigation,
    Outcome,
    letting_go,
    prepared_menu,
)
from eps_hil.physics.model import load_model
from eps_hil.programme.limits import load_limits

from .bench import REFERENCE, written


@pytest.fixture(scope="module")
def menu(tmp_path_factory: pytest.TempPathFactory) -> Menu:
    config = written(tmp_path_factory.mktemp("menu"))
    return prepared_menu(load_model(REFERENCE), load_limits(config), 1.0)


def investigation(config: Path, menu: Menu, said: list[Any] | None = None) -> Investigation:
    setup, model = load_bus_setup(config), load_model(REFERENCE)
    journal = Journal(config.parent / "out", model, menu.limits, simulated=True)
    rig = LockstepRig(config, model)
    say = (said if said is not None else []).append
    return Investigation(setup, menu, journal, lambda _: letting_go(rig), say)


@pytest.mark.slow
def test_it_finds_what_the_rig_holds_and_goes_on_after_an_interruption(
    tmp_path: Path, menu: Menu
) -> None:
    config, out = written(tmp_path), tmp_path / "out"
    ticks = [0]

    def in_the_second_experiment() -> bool:
        ticks[0] += (out / "step_01.json").exists()
        return ticks[0] > 300

    with pytest.raises(InterruptedInvestigationError, match="call again to go on"):
        investigation(config, menu).run(600.0, in_the_second_experiment)
    assert len(list(out.glob("step_*.part.log"))) == 1
    kept = {path.name: path.read_bytes() for path in out.glob("step_01*")}
    assert len(kept) == 2

    outcome = investigation(config, menu).run(60.0)
    for name, content in kept.items():
        assert (out / name).read_bytes() == content, "finished steps stay as they are"
    assert [one["round"] for one in outcome.rounds] == list(range(len(outcome.rounds)))
    last = outcome.rounds[-1]
    assert last["verdict"] == "explained"
    assert [one["effect"] for one in last["findings"]] == ["stribeck"]
    level = last["findings"][0]["parameters"]["level_nm"]["value"]
    assert level == pytest.approx(0.05, rel=0.1)
    assert outcome.rig_s <= 60.0
    assert not list(out.glob("*.part.log"))


@pytest.mark.slow
def test_the_budget_is_kept_over_calls_and_the_page_tells_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, out = written(tmp_path), tmp_path / "out"
    words = ["investigate", "--config", str(config), "--out", str(out), "--simulated"]
    words += ["--budget", "30s", "--json", str(tmp_path / "s.json")]
    assert main([*words, "--write-model", str(tmp_path / "m.yaml")]) == 0
    said = capsys.readouterr().out
    assert "The budget is spent" in said
    content = json.loads((tmp_path / "s.json").read_text())
    assert content["stop"] == "budget"
    assert len(content["rounds"]) == 3
    assert content["rounds"][0]["next"][0]["bits"] > 0.0
    told = (out / "investigation.html").read_text()
    assert "Round by round" in told
    assert content["rounds"][0]["next"][0]["words"] in told
    assert [one["effect"] for one in load_model(tmp_path / "m.yaml").effects] == ["stribeck"]

    assert main(words) == 0
    assert "2 steps" in capsys.readouterr().out
    assert len(list(out.glob("step_*.json"))) == 2, "nothing is left to run it for"
    config.write_text(config.read_text().replace("matters: 0.1", "matters: 0.2"))
    assert main(words) == 2
    assert "other limits" in capsys.readouterr().err


@pytest.mark.slow
def test_beyond_a_limit_it_ends_with_status_3_and_does_not_run_that_again(
    tmp_path: Path, menu: Menu
) -> None:
    """The rig's own torsion bar carries more than the model foresaw."""
    tight = written(
        tmp_path, limits="{load_n: 0, rack_travel_m: 0.02, matters: 0.1, sensor_torque_nm: 1.5}"
    )
    limited = Menu(menu.model, load_limits(tight), menu.shapes, menu.prospects)
    with pytest.raises(SafetyStop, match=r"torsion-bar torque .* the limit is 1\.5 Nm"):
        investigation(tight, limited).run(600.0)
    (step,) = Journal(tmp_path / "out", menu.model, limited.limits, True).steps()
    assert "torsion-bar torque" in step.problem
    assert SafetyStop.exit_status == 3
    with pytest.raises(SafetyStop):
        investigation(tight, limited).run(600.0)
    journal = Journal(tmp_path / "out", menu.model, limited.limits, True)
    steps = journal.steps()
    assert len({one.experiment for one in steps}) == 2
    said = json.dumps(journal.rounds()[-1]["next"][0])
    assert steps[1].experiment.name in said, "what is said to be next is what is run"
    last = {**journal.rounds()[-1], "stop": "nothing_more"}
    assert last["tripped"] == [[step.experiment.words, step.problem]]
    story.write_page(Outcome([last], None, Stop.NOTHING_MORE, 60.0), tmp_path / "p.html", "m.yaml")
    assert step.problem in html.unescape((tmp_path / "p.html").read_text())


@pytest.mark.slow
def test_recordings_that_no_diagnosis_takes_are_not_collected_for_ever(
    tmp_path: Path, menu: Menu, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: Any, **__: Any) -> None:
        raise ValueError("rack_force_n has the wrong sign")

    monkeypatch.setattr("eps_hil.investigate.run.diagnose", refused)
    monkeypatch.setattr("eps_hil.investigate.run._TRIED", 2)
    said: list[Any] = []
    with pytest.raises(EpsHilError, match="after 2 experiments: rack_force_n has the wrong sign"):
        investigation(written(tmp_path), menu, said).run(600.0)
    assert said[1]["problem"] == "rack_force_n has the wrong sign"


def test_a_model_file_without_friction_is_refused(tmp_path: Path) -> None:
    model, limits = load_model(REFERENCE), load_limits(written(tmp_path))
    bare = replace(model.friction, offset_pos_nm=0.0, offset_neg_nm=0.0)
    with pytest.raises(EpsHilError, match="identify it first"):
        prepared_menu(replace(model, friction=bare), limits, 1.0)


@pytest.mark.parametrize(("text", "value"), [("20min", 1200), ("90 s", 90), ("1.5h", 5400)])
def test_a_budget_is_a_time(text: str, value: float) -> None:
    assert seconds(text) == value


@pytest.mark.parametrize("text", ["20", "min", "0s", "-3min", "20 m"])
def test_a_budget_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="write 20min, 90s or 1h"):
        seconds(text)
