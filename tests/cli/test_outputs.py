"""No command writes over a file that it reads; it is refused before anything is touched."""

import inspect
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from eps_hil.cli._outputs import WRITTEN, check_apart, keeps_inputs
from eps_hil.cli.main import app, main
from eps_hil.errors import InputError

ROOT = Path(__file__).parents[2]
READ = {
    "after", "before", "better", "chain", "config", "data_dir", "dbc", "file", "files", "folder",
    "friction_journal", "goldens", "holdout", "live", "log", "model", "recording", "recordings",
    "settings", "signals", "simulation", "simulation_signals", "simulation_values", "source",
    "uncertainty", "inputs",
}  # fmt: skip


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A rig's files in one folder; the configuration."""
    for one in ("configs/reference_rig.yaml", "configs/eps_rig_signals.yaml", "dbc/eps_rig.dbc"):
        shutil.copy(ROOT / one, tmp_path)
    path = tmp_path / "rig.yaml"
    path.write_text(
        "bus: {interface: udp_multicast, channel: 239.74.163.93}\n"
        "dbc: eps_rig.dbc\nsignals: eps_rig_signals.yaml\nmodel: reference_rig.yaml\n"
    )
    return path


def verbs(group: Any) -> Iterator[Any]:
    for one in group.registered_commands:
        yield one.callback
    for one in group.registered_groups:
        yield from verbs(one.typer_instance)


def test_of_every_path_it_is_known_whether_it_is_written() -> None:
    paths = {
        name
        for verb in verbs(app)
        for name, one in inspect.signature(verb, eval_str=True).parameters.items()
        if "Path" in str(getattr(one.annotation, "__origin__", one.annotation))
    }
    assert paths == WRITTEN | READ


@pytest.mark.parametrize("read", ["rig.yaml", "eps_rig.dbc", "eps_rig_signals.yaml",
                                  "reference_rig.yaml"])  # fmt: skip
@pytest.mark.parametrize(
    "words",
    [
        ["run", "--journal"],
        ["run", "--log-estimates"],
        ["monitor", "--once", "--journal"],
        ["calibrate", "torque-injection", "--journal"],
        ["replay", "x.log", "--commands", "--journal"],
        ["dashboard", "--marks"],
        ["golden", "make", "x.log", "--overwrite", "--out"],
        ["prove", "loop", "x.log", "--with", "m.yaml", "--json"],
        ["record", "--overwrite"],
    ],
    ids=" ".join,
)
def test_what_a_configuration_names_is_kept(
    rig: Path, words: list[str], read: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in rig.parent.iterdir()}
    target = str(rig.parent / read)
    assert main([*words, target, "--config", str(rig)]) == 2
    said = capsys.readouterr()
    assert said.err == f"eps-hil: {target}: is read by this command; write to another file\n"
    assert said.out == ""
    assert {path: path.read_bytes() for path in rig.parent.iterdir()} == before


@pytest.mark.parametrize(
    "words",
    [
        ["replay", "{}", "--journal"],
        ["dashboard", "{}", "--config", "c.yaml", "--marks"],
        ["estimate", "x.csv", "--model", "m.yaml", "--friction-journal", "{}", "--json"],
        ["calibrate", "reversals", "{}", "--model", "m.yaml", "--json"],
        ["compare", "x.csv", "--model", "m.yaml", "--live", "{}", "--figure"],
        ["diagnose", "--recording", "x.csv", "--model", "m.yaml", "--simulation-values", "{}",
         "--report"],
        ["identify", "{}", "--model", "m.yaml", "--report"],
        ["simulate", "--model", "m.yaml", "--inputs", "{}", "--out"],
        ["convert", "{}"],
        ["clocks", "{}", "--out"],
    ],
    ids=lambda words: " ".join(words[:2]),
)  # fmt: skip
@pytest.mark.parametrize("link", [Path.symlink_to, Path.hardlink_to])
def test_what_is_given_is_kept_under_whatever_name(
    tmp_path: Path, words: list[str], link: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    given, other = tmp_path / "given.log", tmp_path / "other.log"
    given.write_text("(1.0) can0 123#00\n")
    link(other, given)
    for name in (f"{given.parent}/./{given.name}", str(other)):
        assert main([*(word.format(given) for word in words), name]) == 2
        assert "is read by this command" in capsys.readouterr().err
    assert given.read_text() == "(1.0) can0 123#00\n"


def test_golden_check_keeps_what_the_golden_was_made_from(
    tmp_path: Path,
    rig: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from types import SimpleNamespace

    golden = tmp_path / "golden.csv"
    made_from = SimpleNamespace(log="bus.log", config=rig.name)
    monkeypatch.setattr(
        "eps_hil.oracle.golden_file.read_golden",
        lambda _path: SimpleNamespace(provenance=made_from),
    )
    for name in ("bus.log", rig.name, "reference_rig.yaml"):
        (tmp_path / "bus.log").touch()
        before = (tmp_path / name).read_bytes()
        assert main(["golden", "check", str(golden), "--json", str(tmp_path / name)]) == 2
        assert "is read by this command" in capsys.readouterr().err
        assert (tmp_path / name).read_bytes() == before


def test_a_folder_and_a_file_in_the_models_place_are_left_to_the_verb(rig: Path) -> None:
    done: list[str] = []
    verb = keeps_inputs(lambda **_: done.append("done"))
    verb(config=rig, write_model=rig.parent / "reference_rig.yaml")  # calibrate's levels
    verb(source=rig.parent, out=rig.parent)
    verb(config=rig.parent / "missing.yaml", json=rig.parent / "new.json")
    assert done == ["done"] * 3
    broken = rig.parent / "broken.yaml"
    broken.write_text("a: {")
    verb(config=broken, json=rig.parent / "new.json")  # whoever reads it says so
    with pytest.raises(InputError, match="two outputs"):
        check_apart((rig, Path(os.path.relpath(rig))), ())
