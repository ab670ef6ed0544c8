"""README and docs: links lead somewhere, commands exist, example files are accepted."""

import dataclasses
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from eps_hil import yaml_file
from eps_hil.bus.mapping import load_mapping
from eps_hil.cli.main import app
from eps_hil.programme.limits import Limits
from eps_hil.rig.config import RigConfig
from eps_hil.rig.sensors import SensorSettings
from eps_hil.service.adaptation_config import AdaptationConfig
from eps_hil.service.calibration import CalibrationSettings
from eps_hil.service.config import OverrideConfig, PublishConfig, RuntimeConfig, load_config
from eps_hil.signals import CANONICAL

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("*.md")])
COMMANDS: dict[str, Any] = vars(typer.main.get_command(app))["commands"]
PROMISED_FOR_LATER = re.compile(r"^Not there yet:.*?\n\n", re.MULTILINE | re.DOTALL)


def _names(page: Path) -> str:
    return str(page.relative_to(ROOT))


def _anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("page", PAGES, ids=_names)
def test_links_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))
    for link in links:
        if link.startswith(("http://", "https://")):
            continue
        target, _, anchor = link.partition("#")
        file = (page.parent / target) if target else page
        assert file.exists(), f"{_names(page)}: {link}"
        if anchor:
            assert anchor in _anchors(file), f"{_names(page)}: {link}"


def _commands(page: Path) -> list[list[str]]:
    """Every ``eps-hil VERB …`` of a page, continued lines joined, as words."""
    text = PROMISED_FOR_LATER.sub("", page.read_text(encoding="utf-8")).replace("\\\n", " ")
    found = re.findall(r"`(eps-hil [a-z][^`]*)`|^ {4,}(eps-hil [a-z].*)$", text, re.MULTILINE)
    lines = (one or other for one, other in found)
    return [shlex.split(line, comments=True)[1:] for line in lines]


@pytest.mark.parametrize("page", PAGES, ids=_names)
def test_commands_and_their_options_exist(page: Path) -> None:
    for words in _commands(page):
        assert words[0] in COMMANDS, f"{_names(page)}: eps-hil {words[0]}"
        command, rest = COMMANDS[words[0]], words[1:]
        while rest and rest[0] in getattr(command, "commands", {}):
            command = command.commands[rest.pop(0)]
        parameters = command.params
        known = {word for each in parameters for word in (*each.opts, *each.secondary_opts)}
        used = {word.partition("=")[0].rstrip("]") for word in words if word.startswith("--")}
        assert used <= known, f"{_names(page)}: eps-hil {words[0]} {used - known}"


def test_readme_shows_commands() -> None:
    assert len(_commands(ROOT / "README.md")) > 5


@pytest.mark.parametrize("page", PAGES, ids=_names)
def test_files_of_the_project_that_are_named_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    pattern = r"(?<![\w/{}.])((?:scripts|configs|dbc|eps_hil|docs|tests|\.ci)/[\w./@-]*[\w/])"
    for name in re.findall(pattern, text):
        assert (ROOT / name).exists(), f"{_names(page)}: {name}"


def test_every_page_is_in_the_index() -> None:
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    missing = [page.name for page in (ROOT / "docs").glob("*.md") if f"({page.name})" not in index]
    assert missing == ["index.md"]


def test_every_signal_is_in_the_reference() -> None:
    text = (ROOT / "docs" / "reference-files.md").read_text(encoding="utf-8")
    for signal in CANONICAL.values():
        assert f"| `{signal.name}` | {signal.unit} | {signal.description} |" in text


def test_every_verb_is_in_the_readme() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for verb in COMMANDS:
        assert f"`eps-hil {verb} " in text, verb


def test_the_mapping_that_is_shown_is_a_mapping(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "howto-connect-my-rig.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    mapping, config = blocks
    file = tmp_path / "my_signals.yaml"
    file.write_text(mapping, encoding="utf-8")
    loaded = load_mapping(file)
    assert loaded.sync_message == "MotorStatus"
    assert loaded.signals["motor_speed_rad_s"].scale < 0
    (tmp_path / "run.yaml").write_text(config, encoding="utf-8")
    assert set(yaml_file.read(tmp_path / "run.yaml")) == {"bus", "dbc", "signals", "model"}


def test_the_configuration_that_is_shown_holds_the_defaults(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "reference-config.md").read_text(encoding="utf-8")
    service, override = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    for name in ("../dbc/eps_rig.dbc", "eps_rig_signals.yaml", "reference_rig.yaml"):
        service = service.replace(name, str((ROOT / "configs" / name).resolve()))
    file = tmp_path / "rig.yaml"
    file.write_text(service, encoding="utf-8")
    loaded = load_config(file)
    assert loaded.publish == PublishConfig()
    assert loaded.service == RuntimeConfig()
    assert loaded.adaptation == AdaptationConfig()
    shown = yaml.safe_load(override)["override"]
    fields = {each.name: each.default for each in dataclasses.fields(OverrideConfig)}
    assert shown.keys() == fields.keys()
    assert {name: fields[name] for name in shown if name != "limits"} == {
        name: value for name, value in shown.items() if name != "limits"
    }


def test_the_block_of_the_rig_that_is_shown_holds_the_defaults() -> None:
    text = (ROOT / "docs" / "reference-rig.md").read_text(encoding="utf-8")
    found = re.search(r"```yaml\n(rig:.*?)```", text, re.DOTALL)
    assert found is not None
    shown = yaml.safe_load(found[1])["rig"]
    fields = {each.name: each.default for each in dataclasses.fields(RigConfig)}
    assert shown.keys() == fields.keys()
    assert Path(str(fields["chain"])).name == shown["chain"]
    for name in shown.keys() - {"chain", "model", "sensors"}:
        assert shown[name] == fields[name], name
    assert shown["sensors"].keys() <= {each.name for each in dataclasses.fields(SensorSettings)}


SHOWN = [
    ("howto-investigate.md", "investigate", Limits(), set()),
    ("howto-calibrate-friction.md", "calibration", CalibrationSettings(), {"absent"}),
    ("howto-calibrate-friction.md", "adaptation", AdaptationConfig(), {"method"}),
]


@pytest.mark.parametrize(
    ("page", "block", "defaults", "examples"), SHOWN, ids=lambda one: str(one)[:20]
)
def test_blocks_that_are_shown_hold_the_defaults(
    page: str, block: str, defaults: Any, examples: set[str]
) -> None:
    """``examples``: keys whose value shows how it is written."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    found = re.search(rf"```yaml\n({block}:.*?)```", text, re.DOTALL)
    assert found is not None

    def same(shown: dict[str, Any], of: Any) -> None:
        for name, value in shown.items():
            default = getattr(of, name)
            if isinstance(value, dict):
                same(value, default)
            elif name not in examples:
                assert value == default, name

    same(yaml.safe_load(found[1])[block], defaults)


@pytest.mark.parametrize("name", ["rack_force", "dashboard", "dashboard_diagnosis"])
def test_the_picture_is_small(name: str) -> None:
    (picture,) = (ROOT / "docs" / "images").glob(f"{name}.*")
    assert 10_000 < picture.stat().st_size < 200_000
