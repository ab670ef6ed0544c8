"""Steps on disk: whole or not at all, and of one investigation."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from eps_hil.errors import InputError
from eps_hil.investigate.experiment import Experiment, Kind
from eps_hil.investigate.journal import Journal, Step, next_number
from eps_hil.investigate.lockstep import simulated_rig
from eps_hil.physics.model import load_model
from eps_hil.programme.limits import Limits

from .bench import written

MODEL = load_model(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")
EXPERIMENT = Experiment(Kind.LOAD_SINE, 20.0, 1000.0, 0.5, 0.3)


def test_steps_come_back_as_they_were(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "out", MODEL, Limits(), simulated=True)
    log = journal.log_of(1, EXPERIMENT)
    steps = [Step(1, EXPERIMENT, 12.5, log), Step(2, EXPERIMENT, 3.0, log, "beyond a limit")]
    for step in steps:
        journal.write_step(step)
    again = Journal(tmp_path / "out", MODEL, Limits(), simulated=True)
    assert again.steps() == steps


def test_a_log_that_is_being_written_is_no_step(tmp_path: Path) -> None:
    journal = Journal(tmp_path, MODEL, Limits(), simulated=True)
    journal.log_of(1, EXPERIMENT).with_suffix(".part.log").write_text("half a")
    journal.log_of(2, EXPERIMENT).write_text("whole, but its step was never written")
    assert journal.steps() == []


def test_another_rig_or_model_or_other_limits_are_refused(tmp_path: Path) -> None:
    Journal(tmp_path, MODEL, Limits(), simulated=True)
    others = (
        (replace(MODEL, inertia_kg_m2=3e-4), Limits(), True),
        (MODEL, Limits(load_n=1.0), True),
        (MODEL, Limits(), False),
    )
    for model, limits, simulated in others:
        with pytest.raises(InputError, match="another model file, other limits"):
            Journal(tmp_path, model, limits, simulated)


def test_another_database_mapping_or_bus_is_refused(tmp_path: Path) -> None:
    Journal(tmp_path, MODEL, Limits(), True, "one")
    Journal(tmp_path, MODEL, Limits(), True, "one")
    with pytest.raises(InputError, match="made with another database, mapping, bus or"):
        Journal(tmp_path, MODEL, Limits(), True, "other")
    head = json.loads((tmp_path / "investigation.json").read_text())
    del head["rig"]
    (tmp_path / "investigation.json").write_text(json.dumps(head))
    with pytest.raises(InputError, match="does not say with which database"):
        Journal(tmp_path, MODEL, Limits(), True, "one")


def test_a_step_that_was_deleted_gives_its_number_to_no_other(tmp_path: Path) -> None:
    """The second of three is gone: the next was the third again, and its log written over."""
    steps = [Step(k, EXPERIMENT, 1.0, tmp_path / f"{k}.log") for k in (1, 3)]
    assert next_number(steps) == 4
    assert next_number([]) == 1


def test_a_damaged_step_is_said(tmp_path: Path) -> None:
    journal = Journal(tmp_path, MODEL, Limits(), simulated=True)
    (tmp_path / "step_01.json").write_text(json.dumps({"number": 1}))
    with pytest.raises(InputError, match="is no step"):
        journal.steps()
    (tmp_path / "step_01.json").write_text("{")
    with pytest.raises(InputError, match="cannot be read"):
        journal.steps()


def test_a_hundredth_step_comes_after_the_eleventh(tmp_path: Path) -> None:
    """By their names it came after the tenth, and the last round was not the last."""
    journal = Journal(tmp_path, MODEL, Limits(), simulated=True)
    for number in (9, 10, 11, 99, 100):
        journal.write_step(Step(number, EXPERIMENT, 1.0, journal.log_of(number, EXPERIMENT)))
        journal.write_round({"round": number})
    assert [one.number for one in journal.steps()] == [9, 10, 11, 99, 100]
    assert [one["round"] for one in journal.rounds()] == [9, 10, 11, 99, 100]


def test_another_simulated_rig_is_known_as_one(tmp_path: Path) -> None:
    """Its hidden physics is in no model file that the head has: old logs were its own."""
    config = written(tmp_path)
    before = simulated_rig(config)
    assert simulated_rig(config) == before
    config.write_text(config.read_text().replace("order: 2", "order: 3"))
    assert simulated_rig(config) != before
    config.write_text(config.read_text().replace("order: 3", "order: 2"))
    hidden = tmp_path / "rig.yaml"
    hidden.write_text(hidden.read_text().replace("level_nm: 0.05", "level_nm: 0.06"))
    assert simulated_rig(config) != before
