"""What a YAML file may hold at all, before any field of it is known."""

from pathlib import Path

import pytest
import yaml

from eps_hil import yaml_file
from eps_hil.cli.main import main
from eps_hil.errors import InputError

ROOT = Path(__file__).parents[1]


def test_a_key_that_stands_twice_is_refused_with_both_lines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The last one would be taken, without a word: here of a limit of the torque guard."""
    file = tmp_path / "c.yaml"
    text = (ROOT / "configs" / "calibrate_udp.yaml").read_text()
    (line,) = (one for one in text.splitlines() if "max_torque_nm:" in one)
    first = text.splitlines().index(line) + 1
    file.write_text(text.replace(line, line + "\n" + line.replace("0.4", "4.0")))
    assert main(["calibrate", "torque-injection", "--config", str(file), "--dry-run"]) == 2
    said = capsys.readouterr().err
    assert f"c.yaml: line {first + 1}, column 5: not valid YAML: 'max_torque_nm' stands" in said
    assert f"on line {first};" in said


def test_the_same_key_in_other_blocks_and_over_a_merged_one(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text("a: &a {x: 1}\nb: {<<: *a, x: 2}\nc: [{x: 3}, {x: 4}, *a]\n")
    assert yaml_file.read(file) == {
        "a": {"x": 1},
        "b": {"x": 2},
        "c": [{"x": 3}, {"x": 4}, {"x": 1}],
    }
    file.write_text("")
    assert yaml_file.read(file) is None


@pytest.mark.parametrize("text", ["a: [\n", "a: \x01\n", "a: 1\n---\nb: 2\n"])
def test_what_is_no_yaml_is_one_line(text: str, tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match="not valid YAML"):
        yaml_file.read(file)


def test_a_quick_parser_reads_the_same_and_refuses_tabs_as_ever(tmp_path: Path) -> None:
    files = sorted((ROOT / "configs").rglob("*.yaml"))
    assert len(files) > 10
    for file in files:
        assert yaml_file.read(file) == yaml.safe_load(file.read_text())
    file = tmp_path / "c.yaml"
    file.write_text("a: 1\nb: \t2\n")
    with pytest.raises(InputError, match=r"c\.yaml: line 2, column 4: not valid YAML: found char"):
        yaml_file.read(file)
    file.write_text("a: 1\nb: c: 2\n")
    with pytest.raises(
        InputError, match=r"line 2, column 5: .*mapping values are not allowed here"
    ):
        yaml_file.read(file)
