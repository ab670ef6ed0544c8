"""A programme is gone on with by the same plan on the same rig alone."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from eps_hil.bus.config import load_bus_setup
from eps_hil.errors import InputError
from eps_hil.identification.constant_speed import Cell
from eps_hil.programme import cell_record
from eps_hil.programme.cell_record import CellResult
from eps_hil.programme.fingerprint import fingerprint
from eps_hil.programme.run import PLAN_FILE, prepare_folder

from .link_bench import MODEL, SIGNALS, written
from .programme_bench import PLAN


def finished(folder: Path, problems: tuple[str, ...] = ()) -> None:
    """The first cell, as a run leaves it."""
    cell = PLAN.cells()[0]
    found = Cell(cell.speed_rad_s, cell.preload_n, cell.speed_rad_s, cell.preload_n, 0.06)
    cell_record.write(CellResult(cell, found, 400, 0, 3, problems), folder)


def test_a_cell_that_was_left_out_is_run_again(tmp_path: Path) -> None:
    prepare_folder(tmp_path, PLAN, "rig", resume=False)
    finished(tmp_path)
    assert len(prepare_folder(tmp_path, PLAN, "rig", resume=True)) == 1
    finished(tmp_path, ("7 frames lost",))
    assert prepare_folder(tmp_path, PLAN, "rig", resume=True) == []


def test_a_folder_with_nothing_to_go_on_with_is_refused(tmp_path: Path) -> None:
    """A mistyped --out began the programme anew."""
    with pytest.raises(InputError, match=r"ruun: --resume: holds no programme to go on with"):
        prepare_folder(tmp_path / "ruun", PLAN, "rig", resume=True)
    assert not (tmp_path / "ruun").exists()


def test_cells_of_another_rig_are_refused(tmp_path: Path) -> None:
    prepare_folder(tmp_path, PLAN, "rig", resume=False)
    finished(tmp_path)
    with pytest.raises(InputError, match="made with another model, database, mapping or bus"):
        prepare_folder(tmp_path, PLAN, "other", resume=True)
    with pytest.raises(InputError, match="made by another programme"):
        prepare_folder(tmp_path, replace(PLAN, run_s=0.6), "rig", resume=True)
    head = json.loads((tmp_path / PLAN_FILE).read_text())
    del head["rig"]
    (tmp_path / PLAN_FILE).write_text(json.dumps(head))
    with pytest.raises(InputError, match="does not say with which model"):
        prepare_folder(tmp_path, PLAN, "rig", resume=True)


def test_what_makes_another_rig(tmp_path: Path) -> None:
    setup = written(tmp_path)
    one = fingerprint(setup, MODEL)
    assert one == fingerprint(load_bus_setup(tmp_path / "c.yaml"), MODEL)
    commented = tmp_path / "commented.yaml"
    commented.write_text("# the same\n" + SIGNALS.read_text())
    same_bus = replace(setup.bus, reconnect=False)
    assert one == fingerprint(replace(setup, signals=commented, bus=same_bus), MODEL)
    turned = tmp_path / "turned.yaml"
    turned.write_text(SIGNALS.read_text().replace("RackForce}", "RackForce, scale: -1.0}"))
    longer = tmp_path / "longer.dbc"
    longer.write_text(setup.dbc[0].read_text() + "\n")
    for other in (
        fingerprint(setup, replace(MODEL, inertia_kg_m2=3e-4)),
        fingerprint(replace(setup, signals=turned), MODEL),
        fingerprint(replace(setup, dbc=(longer,)), MODEL),
        fingerprint(replace(setup, bus=replace(setup.bus, channel="can1")), MODEL),
    ):
        assert other != one
