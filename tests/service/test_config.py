"""The configuration file: defaults, paths relative to it, mistakes in one line with the place."""

from collections.abc import Callable
from pathlib import Path

import pytest

from eps_hil.bus.config import block, load_bus_setup
from eps_hil.errors import InputError
from eps_hil.service.config import config_schema, load_config

Write = Callable[[str], Path]

HEAD = """bus: {interface: virtual, channel: 7}
dbc: parts/a.dbc
signals: parts/s.yaml
model: parts/m.yaml
"""


@pytest.fixture
def write(tmp_path: Path) -> Write:
    parts = tmp_path / "parts"
    parts.mkdir()
    for name in ("a.dbc", "s.yaml", "m.yaml"):
        (parts / name).write_text("")

    def _write(text: str) -> Path:
        path = tmp_path / "c.yaml"
        path.write_text(text)
        return path

    return _write


def test_defaults_and_paths_relative_to_the_file(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(HEAD)
    monkeypatch.chdir("/")
    config = load_config(path)
    assert config.bus.channel == "7"  # a channel number is a name too
    assert config.dbc == (tmp_path / "parts" / "a.dbc",)
    assert config.model == tmp_path / "parts" / "m.yaml"
    assert config.publish.enabled
    assert config.bus.reconnect
    assert config.estimator.friction_compensation


def test_bare_off_means_off(write: Write) -> None:
    assert load_config(write(HEAD + "service: {realtime: off}\n")).service.realtime == "off"


def test_the_rig_block_passes_through(write: Write) -> None:
    path = write(HEAD + "rig: {anything: [1, 2]}\n")
    assert load_config(path).rig == {"anything": [1, 2]}
    assert block(path, "rig") == {"anything": [1, 2]}
    assert block(path, "publish") == {}
    assert load_bus_setup(path).bus.interface == "virtual"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("bus: {interface: virtual}\n" + HEAD.split("\n", 1)[1], "line 1: bus.channel: is missing"),
        (HEAD + "speed: 3\n", "line 5: speed: is not a known field"),
        (HEAD + "estimator:\n  dead_zon: 1\n", "line 6: estimator.dead_zon: is not a known"),
        (HEAD + "publish: {listen_first_s: soon}\n", "line 5: publish.listen_first_s"),
        (HEAD + "service: {realtime: maybe}\n", "'auto', 'require' or 'off'"),
        (HEAD.replace("m.yaml", "n.yaml"), "no such file"),
        (HEAD.replace("parts/a.dbc", "[]"), "dbc"),
        (HEAD + "publish: {message: A, health_message: A}\n", "are the same"),
        ("", "line 1"),
        ("[1, 2]\n", "line 1"),
    ],
)
def test_a_mistake_is_one_line_with_its_place(write: Write, text: str, said: str) -> None:
    path = write(text)
    with pytest.raises(InputError) as caught:
        load_config(path)
    assert str(caught.value).startswith(str(path))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_schema_covers_the_blocks() -> None:
    known = {"bus", "dbc", "signals", "model", "estimator", "publish", "service", "rig"}
    known |= {"adaptation", "override", "calibration", "investigate"}
    assert known == set(config_schema()["properties"])
