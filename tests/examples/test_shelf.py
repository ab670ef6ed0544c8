"""Example files: listed with a line each, copied with what they refer to, paths that work."""

import subprocess
import sys
from pathlib import Path

import pytest

from eps_hil.cli.main import main
from eps_hil.errors import InputError
from eps_hil.examples import CONFIGS, DBC, shelf
from eps_hil.physics.model import load_model
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.manoeuvre import load_manoeuvre
from eps_hil.service.config import load_config
from eps_hil.service.setup import prepare

ROOT = Path(__file__).parents[2]
ON_A_BUS = [one.name for one in shelf.examples() if "\nbus:" in one.path.read_text()]


def test_every_file_of_the_package_has_a_name_and_a_line() -> None:
    found = shelf.examples()
    files = {path for folder in (CONFIGS, DBC) for path in folder.rglob("*") if path.is_file()}
    files = {path for path in files if shelf.SCHEMAS not in path.parents}
    assert {one.path for one in found} == files, "a file that no wildcard of the shelf finds"
    assert all(10 < len(one.about) < 130 for one in found), [one.about for one in found]
    assert all(shelf.find(one.name) == one for one in found)


@pytest.mark.parametrize("name", ON_A_BUS)
def test_a_configuration_copied_out_alone_has_all_it_needs(name: str, tmp_path: Path) -> None:
    copied = shelf.copy(name, tmp_path)
    config = copied[0].path
    setup = load_config(config)
    assert all(file.is_relative_to(tmp_path) for file in (*setup.dbc, setup.signals, setup.model))
    prepare(setup, config)
    load_rig_setup(config)


def test_configurations_on_a_bus_are_found() -> None:
    assert {"demo_udp", "demo_vcan", "calibrate_udp", "ford_gt350/run"} <= set(ON_A_BUS)


def test_a_copy_is_made_once_and_never_over_somebodys_own(tmp_path: Path) -> None:
    assert all(one.written for one in shelf.copy("demo_udp", tmp_path))
    assert not any(one.written for one in shelf.copy("demo_udp", tmp_path))
    model = tmp_path / "configs" / "reference_rig.yaml"
    model.write_text("mine")
    (tmp_path / "dbc" / "eps_rig.dbc").unlink()
    with pytest.raises(InputError, match="is there already and differs"):
        shelf.copy("demo_udp", tmp_path)
    assert model.read_text() == "mine"
    assert not (tmp_path / "dbc" / "eps_rig.dbc").exists()  # nothing half done
    shelf.copy("demo_udp", tmp_path, overwrite=True)
    load_model(model)


def test_all_of_them(tmp_path: Path) -> None:
    copied = shelf.copy(shelf.ALL, tmp_path)
    schemas = set(shelf.SCHEMAS.iterdir())
    assert len(copied) == len(shelf.examples()) + len(schemas)
    load_manoeuvre(str(tmp_path / "configs" / "manoeuvres" / "demo.yaml"))


def test_a_last_part_is_enough_and_a_wrong_name_is_said() -> None:
    assert shelf.find("weave").name == "manoeuvres/weave"
    assert shelf.find("configs/ford_gt350/run.yaml").name == "ford_gt350/run"
    with pytest.raises(InputError, match="`eps-hil example` lists them"):
        shelf.find("nothing")


def test_the_verb(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["example"]) == 0
    assert "demo_udp" in capsys.readouterr().out
    assert main(["example", "demo_udp", str(tmp_path / "new")]) == 0
    said = capsys.readouterr().out
    assert f"wrote: {tmp_path}/new/configs/demo_udp.yaml" in said
    assert f"run: eps-hil rig --config {tmp_path}/new/configs/demo_udp.yaml" in said
    (diagnose,) = (line for line in said.splitlines() if line.startswith("run: eps-hil diagnose"))
    named = [word for word in diagnose.split() if word.startswith(str(tmp_path))]
    assert [Path(each).is_file() for each in named] == [True] * 3  # model, database, mapping
    assert main(["example", "nothing"]) == 2


def test_a_folder_that_cannot_be_made_is_wrong_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine")
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        assert main(["example", "demo_udp", str(place)]) == 2
        said = capsys.readouterr().err
        assert said.startswith(f"eps-hil: {place}/configs/demo_udp.yaml: DIR: cannot be made: ")
        assert said.endswith("; choose another folder\n")
    assert (tmp_path / "file").read_text() == "mine"


def test_the_checkouts_own_names_lead_into_the_package() -> None:
    assert (ROOT / "configs").resolve() == CONFIGS
    assert (ROOT / "dbc").resolve() == DBC
    setup = load_config(ROOT / "configs" / "demo_udp.yaml")
    assert setup.dbc == (DBC / "eps_rig.dbc",)


def test_python_m_eps_hil(tmp_path: Path) -> None:
    said = subprocess.run(
        [sys.executable, "-m", "eps_hil", "--version"],
        cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert said.stdout.startswith("eps-hil ")
