"""JSON schemas: as committed, and every example fits its own."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from eps_hil.check.schemas import SCHEMAS, schema
from eps_hil.cli.main import main
from eps_hil.examples import CONFIGS, shelf

YAML = sorted(CONFIGS.rglob("*.yaml"))


@pytest.mark.parametrize("kind", SCHEMAS)
def test_the_package_holds_what_the_verb_prints(
    kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """``scripts/schemas.py`` writes them anew."""
    assert main(["check", "--schema", kind]) == 0
    assert capsys.readouterr().out == (shelf.SCHEMAS / f"{kind}.json").read_text()


def violations(kind: str, content: Any) -> list[str]:
    jsonschema = pytest.importorskip("jsonschema")
    return [
        one.message for one in jsonschema.Draft202012Validator(schema(kind)).iter_errors(content)
    ]


@pytest.mark.parametrize("path", YAML, ids=lambda path: str(path.relative_to(CONFIGS)))
def test_every_example_fits_its_schema(path: Path) -> None:
    line = path.read_text().partition("\n")[0]
    kind = Path(line.removeprefix(shelf._EDITOR)).stem
    assert not violations(kind, yaml.safe_load(path.read_text()))


def test_a_schema_refuses_what_the_reader_refuses() -> None:
    whole = yaml.safe_load((CONFIGS / "reference_rig.yaml").read_text())
    whole["model"]["effects"] = [{"effect": "stribeck", "level_nm": 0.05, "speed_rad_s": 8.0}]
    assert not violations("model", whole)
    whole["model"]["effects"] = [{"effect": "stribeck", "level": 0.05}]
    assert violations("model", whole)
    config = yaml.safe_load((CONFIGS / "demo_udp.yaml").read_text())
    config["rig"]["order"] = 7
    assert violations("config", config)
    assert json.dumps(schema("config"))


def test_a_mapping_is_of_a_database_or_of_a_table() -> None:
    table = {"time": {"column": "ms", "scale": 1e-3}, "signals": {"rack_force_n": {"sum": ["a"]}}}
    assert not violations("signals", table)
    table["signals"] = {"rack_force_n": {"sums": ["a"]}}
    assert violations("signals", table)
    assert not violations("signals", {"signals": {"rack_force_n": {"message": "M", "signal": "S"}}})
