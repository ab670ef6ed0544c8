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


def _laughs(first: str, more: str) -> str:
    """Each line holds the one before several times."""
    return first + "".join(more.format(i, i - 1) for i in range(1, 40))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 3000 + "]" * 3000, "line 1, column 101: nested deeper than 100 levels"),
        ("{a: " * 3000 + "1" + "}" * 3000, "line 1, column 401: nested deeper than 100 levels"),
        ("- " * 3000 + "a", "nested deeper than 100 levels"),
        ("".join(" " * i + "a:\n" for i in range(1200)), "nested deeper than 100 levels"),
        ("[" * 100_000, "nested deeper than 100 levels"),
        (_laughs("a0: &a0 [1]\n", "a{0}: &a{0} [*a{1}, *a{1}]\n"), "aliases make more than"),
        (_laughs("a0: &a0 {b: 1}\n", "a{0}: &a{0} {{<<: [*a{1}, *a{1}]}}\n"), "aliases make more"),
        ("a: &a [*a]\n", "line 1, column 4: holds itself through an alias; write it out"),
        ("a: 1\nb: \0\n", "line 2: not valid YAML: holds the character #x0000; take it out"),
        ("a: 2020-13-45\n", "line 1, column 4: cannot be read as timestamp: '2020-13-45';"),
        ("a: 1\nb: " + "9" * 5000, "line 2, column 4: cannot be read as int: '999999"),
        ("a: !!int [1]\n", "not valid YAML: expected a scalar node"),
        ("a: !!bool perhaps\n", "cannot be read as bool: 'perhaps'; correct it, or put it in"),
        ("a: !!timestamp soon\n", "cannot be read as timestamp: 'soon'"),
    ],
)
def test_what_would_break_the_parser_is_one_line(text: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        yaml_file.read(file)
    assert f"{file}: " in str(caught.value)
    assert said in str(caught.value)
    assert len(str(caught.value)) < 400


def test_a_recording_in_place_of_settings_is_not_read_to_its_end(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    with file.open("wb") as sparse:
        sparse.truncate(200_000_000)
    with pytest.raises(InputError, match="is larger than 1 MB, a YAML file of settings was exp"):
        yaml_file.read(file)
    file.write_bytes("a: 1\n".encode("utf-16"))
    with pytest.raises(InputError, match="is not UTF-8 text"):
        yaml_file.read(file)


@pytest.mark.parametrize("option", ["--model", "--signals"])
def test_a_verb_names_the_file_that_is_nested_without_end(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    deep = tmp_path / "deep.yaml"
    deep.write_text("[" * 3000 + "]" * 3000)
    recording = tmp_path / "r.csv"
    recording.write_text("t,motor_torque_nm,motor_speed_rad_s\n0,0,0\n0.001,0,0\n")
    given = {"--model": str(ROOT / "configs" / "reference_rig.yaml")} | {option: str(deep)}
    words = [word for pair in given.items() for word in pair]
    assert main(["estimate", str(recording), *words]) == 2
    said = capsys.readouterr().err
    assert "deep.yaml: line 1, column 101: nested deeper than 100 levels" in said
    assert said.count("\n") == 1


def test_a_long_value_is_shown_in_part(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(f"a: {list(range(10_000))}\n")
    with pytest.raises(InputError, match=r"\(found \[0, 1, .*…\)") as caught:
        yaml_file.load(file, dict[str, int])
    assert len(str(caught.value)) < 400
