import subprocess
import sys
from pathlib import Path

import pytest

from eps_hil.bus.database import find_message, load_database, nearest
from eps_hil.errors import InputError

OVERLAP = """VERSION ""
BO_ 1 A: 1 X
 SG_ S : 0|8@1+ (1,0) [0|0] "" Y
 SG_ T : 4|8@1+ (1,0) [0|0] "" Y
"""
GOOD = """VERSION ""
BO_ {id} {name}: 8 X
 SG_ S : 0|8@1+ (1,0) [0|0] "" Y
"""


def failure(path: Path, **options: bool) -> str:
    with pytest.raises(InputError) as caught:
        load_database([path], **options)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(str(path))
    return text


def test_missing_file(tmp_path: Path) -> None:
    assert "no such file" in failure(tmp_path / "none.dbc")


def test_folder_and_foreign_suffix(tmp_path: Path) -> None:
    assert "cannot be read" in failure(tmp_path)
    other = tmp_path / "notes.txt"
    other.write_text("hello")
    assert "not readable as a CAN database" in failure(other)


@pytest.mark.parametrize("content", [b"", b"hello", bytes(range(256)) * 8, b"\xff\xfe\x00"])
def test_what_is_no_database(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "broken.dbc"
    path.write_bytes(content)
    assert "line 1" in failure(path)


def test_syntax_error_names_the_line(tmp_path: Path) -> None:
    path = tmp_path / "broken.dbc"
    path.write_text(GOOD.format(id=1, name="A") + 'BO_ 2 B: 8\n SG_ S : 0|8@1+ (1) "" Y\n')
    assert "line 5" in failure(path)


def test_overlapping_signals_are_refused_and_readable_without_strict(tmp_path: Path) -> None:
    path = tmp_path / "overlap.dbc"
    path.write_text(OVERLAP)
    text = failure(path)
    assert "message A" in text
    assert "strict: false" in text
    assert find_message(load_database([path], strict=False), "A") is not None


def test_several_files_read_as_one(tmp_path: Path) -> None:
    paths = [tmp_path / "a.dbc", tmp_path / "b.dbc"]
    for i, path in enumerate(paths, start=1):
        path.write_text(GOOD.format(id=i, name=f"M{i}"))
    database = load_database(paths)
    assert [m.name for m in database.messages] == ["M1", "M2"]
    assert find_message(database, "M3") is None


def test_a_file_is_parsed_again_when_it_has_changed(tmp_path: Path) -> None:
    path = tmp_path / "a.dbc"
    path.write_text(GOOD.format(id=1, name="A"))
    first = load_database([path])
    assert load_database([path]).messages[0] is first.messages[0]
    path.write_text(GOOD.format(id=1, name="B"))
    assert [m.name for m in load_database([path]).messages] == ["B"]
    assert [m.name for m in first.messages] == ["A"]


def two(tmp_path: Path, first: str, second: str) -> list[Path]:
    paths = [tmp_path / "a.dbc", tmp_path / "b.dbc"]
    for path, text in zip(paths, (first, second), strict=True):
        path.write_text(text)
    return paths


LOAD_AND_FIND = """import sys
from eps_hil.bus.database import find_message, load_database
from eps_hil.errors import InputError
for name in sys.argv[1].split(","):
    try:
        print(len(load_database(sys.argv[2:]).messages), end=" ")
        print(find_message(load_database(sys.argv[2:]), name).name)
    except InputError as error:
        print(error)
"""


def said(paths: list[Path], *names: str) -> list[str]:
    """What a program prints that loads the files and looks for messages; stderr stays empty."""
    command = [sys.executable, "-c", LOAD_AND_FIND, ",".join(names), *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout.splitlines()


def test_a_message_that_two_files_define_alike_is_there_once(tmp_path: Path) -> None:
    good = GOOD.format(id=1, name="A")
    same = 'VERSION "another"\nBU_: X\n' + good.split("\n", 1)[1]
    assert said(two(tmp_path, good, same), "A") == ["1 A"]


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(GOOD.format(id=2, name="A"), id="another id", marks=pytest.mark.slow),
        pytest.param(GOOD.format(id=1, name="A").replace("(1,0)", "(0.5,0)"), id="another scale"),
    ],
)
def test_a_name_for_different_messages_is_refused_where_it_is_used(
    tmp_path: Path, other: str
) -> None:
    paths = two(tmp_path, GOOD.format(id=1, name="A"), other + "BO_ 3 B: 1 X\n")
    refused = f"{paths[0]} + {paths[1]}: A: 2 different messages have this name"
    asked_for, other_one = said(paths, "A", "B")
    assert asked_for.startswith(f"3 {refused}")
    assert other_one == "3 B", "nobody who does not ask for A is kept from his work"


def test_nearest_names() -> None:
    assert nearest("MotorSped", ["Crc", "MotorSpeed"]) == "nearest: MotorSpeed"
    assert nearest("zzz", ["A", "B"]) == "there is: A, B"
    assert nearest("zzz", []) == "there is none"
