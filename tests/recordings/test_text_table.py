"""Text tables of other tools: what is read of them, and what is refused, by line and column."""

import re
from pathlib import Path

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.recordings.foreign import read_table
from eps_hil.recordings.read import read_recording
from eps_hil.recordings.recording import Recording

MAPPING = "time: {column: ms, scale: 0.001}\nsignals: {motor_torque_nm: {column: trq}}\n"
PLAIN = "ms,trq,F\n0,1.5,7\n1,2.5,8\n2,3.5,9\n"
QUOTED = '"ms","trq","F"\n"0","1.5","7"\n"1","2.5","8"\n"2","3.5","9"\n'
GERMAN = PLAIN.replace(",", ";").replace(".", ",")


def read(
    folder: Path, content: str | bytes, mapping: str = MAPPING, gaps: str = "refuse"
) -> Recording:
    path, columns = folder / "rig.csv", folder / "columns.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    columns.write_text(mapping, encoding="utf-8")
    return read_recording(path, signals=columns, gaps=gaps)


@pytest.mark.parametrize(
    "content",
    [
        PLAIN,
        GERMAN,
        PLAIN.replace(",", "\t"),
        PLAIN.replace(",", "\t").replace("\t7", "\t1,007").replace("\t8", "\ta, b"),
        GERMAN.replace("7", "7.1").replace("8", "1.2.2026"),
        PLAIN.replace("\n", "\r\n"),
        PLAIN.encode("utf-16"),
        PLAIN.encode("utf-16-be").join([b"\xfe\xff", b""]),
        PLAIN.encode("utf-8-sig"),
        QUOTED,
        QUOTED.replace(",", ";").replace(".", ","),
        "sep=;\n" + GERMAN,
        "SEP=,\r\n" + PLAIN,
        "# bench 7\n#, and more; of it\n\n" + PLAIN,
        "# " + PLAIN,
        PLAIN.replace("F\n", "F\n[ms],[Nm],[N]\n"),
        PLAIN.replace("F\n", "F\nms,1,1\n"),
        PLAIN.replace("F\n", "F\n\n"),
        PLAIN.replace(",7", ",on").replace(",8", ",").replace(",9", ",12:30:00"),
        PLAIN.replace(",7", ",n/a"),
        PLAIN.replace(",7", ',"a, b\nand ""c"""'),
        PLAIN.replace(",7", ",2026-01-01 10:00:00.5"),
        PLAIN.replace(",7", ",#1"),
        PLAIN.replace("\n", ",\n"),
        PLAIN.replace("\n", ",\n").replace("F,", "F"),
        PLAIN.replace(",7", ",7,").replace("F", "F,").replace(",8", ",8,").replace(",9", ",9,x"),
        PLAIN + ",,\n,,\n\n",
        PLAIN.replace(",", " , "),
        PLAIN.replace("F", "trq2,F").replace(",7", ",5,7").replace(",8", ",5,8")
        .replace(",9", ",5,9"),
        PLAIN.replace("F", "F µ").encode("cp1252"),
    ],
)  # fmt: skip
def test_as_tools_write_it(tmp_path: Path, content: str | bytes) -> None:
    found = read(tmp_path, content)
    torque = found.series["motor_torque_nm"]
    assert torque.t_ns.tolist() == [0, 1_000_000, 2_000_000]
    assert torque.value.tolist() == [1.5, 2.5, 3.5]
    assert found.notes[0].startswith("columns left out: ")
    assert "F" in found.notes[0]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (PLAIN.replace("F", "trq"), "line 1: column 'trq' is there twice; remove one"),
        (PLAIN.replace("F", "ms"), "line 1: column 'ms' is there twice"),
        ("# of\n" + PLAIN.replace("F", "trq"), "line 2: column 'trq' is there twice"),
        (
            "ms,trq,F\n1,0,1.5,7\n2,1,2.5,8\n",
            "line 2: 4 cells where there are 3 names; name every column (R: write.csv, row.names",
        ),
        (PLAIN.replace("1,2.5", "1,2,5"), "line 3: 4 cells where the header has 3"),
        (PLAIN.replace("1,2.5,8", "1,2.5"), "line 3: 2 cells where the header has 3"),
        (PLAIN.replace("1,2.5", "#1,2.5"), "line 3: begins with '#'; take the line out"),
        (PLAIN + "# end\n", "line 5: begins with '#'"),
        (PLAIN.replace("1.5", "n/a"), "line 2, column trq: 'n/a' is not a number"),
        (PLAIN.replace("0,1.5", "n/a,n/a"), "line 2, column ms: 'n/a' is not a number"),
        (PLAIN.replace("0,1.5", "nan,nan"), "line 2, column ms: is not a time in seconds"),
        (PLAIN.replace("0,1.5", "n/a,1.5"), "line 2, column ms: 'n/a' is not a number"),
        (PLAIN.replace("2.5", "#N/A"), "line 3, column trq: '#N/A' is not a number"),
        ("# a\n\n" + PLAIN.replace("2.5", "on"), "line 5, column trq: 'on' is not a number"),
        (PLAIN.replace("F\n", "F\nms,Nm,N\n").replace("2.5", "x"), "line 4, column trq: 'x'"),
        (QUOTED.replace("2.5", "2,5"), "line 3, column trq: '2,5' has a decimal comma"),
        (QUOTED.replace('"2.5"', '"2.5'), "quotes do not match"),
        (GERMAN.replace("2,5", "1.002,5"), "line 3, column trq: '1.002.5' is not a number"),
        (
            PLAIN.replace(",", "\t").replace("2.5", "1,012"),
            "line 3, column 'trq': '1,012' has a comma where other numbers have points; export",
        ),
        (
            QUOTED.replace(",", ";").replace("2.5", "1,012"),
            "line 3, column 'trq': '1,012' has a comma where other numbers have points",
        ),
        (GERMAN.replace("\n2;", "\n2.0;"), "line 2, column 'trq': '1,5' has a comma where other"),
        (PLAIN.replace("2.5", "nan"), "line 3, column motor_torque_nm: is NaN or infinite"),
        (
            PLAIN.replace("2.5", "") + "3,4.5,9\n4,5.5,9\n",
            "line 3, column motor_torque_nm: is empty in a filled",
        ),
        (PLAIN.replace("1,2.5", ",2.5"), "line 3, column ms: is empty"),
        (PLAIN.replace("ms", "Zeit"), "column 'ms': is missing; there are: Zeit, trq, F"),
        ("0,1\n1,2\n", "line 1: holds numbers, no column names"),
        ("ms,trq\n", "line 2: no line of numbers follows the names"),
        ("ms,trq\n" + "a,b\n" * 9 + "0,1\n", "line 5: no line of numbers follows the names"),
        ("\n\n", "is empty"),
        (PLAIN.encode()[:-3] + b"\0", "line 4: holds binary data"),
        (b"\xff\xfe" + PLAIN.encode("utf-16-le")[:-1], "is broken UTF-16"),
    ],
)
def test_what_is_wrong_is_said_with_line_and_column(
    tmp_path: Path, content: str | bytes, said: str
) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        read(tmp_path, content)


def test_data_that_look_like_units_are_data(tmp_path: Path) -> None:
    found = read(tmp_path, "ms,trq\n1,1\n2,1\n")
    assert found.series["motor_torque_nm"].value.tolist() == [1.0, 1.0]


def test_a_name_behind_a_comment_sign_may_be_meant(tmp_path: Path) -> None:
    mapping = MAPPING.replace("column: ms", "column: '# ms'")
    found = read(tmp_path, "# " + PLAIN, mapping)
    assert found.series["motor_torque_nm"].value.tolist() == [1.5, 2.5, 3.5]


def test_a_long_table_with_text_and_holes(tmp_path: Path) -> None:
    """Long enough for the quick way."""
    rows = [f"{k},{'' if k == 5000 else k / 8},{'on' if k % 2 else 'n/a'}" for k in range(20_000)]
    content = "ms,trq,state\n" + "\n".join(rows)
    with pytest.raises(InputError, match="line 5002, column motor_torque_nm: is empty"):
        read(tmp_path, content)
    found = read(tmp_path, content, gaps="mark").series["motor_torque_nm"]
    assert np.flatnonzero(np.isnan(found.value)).tolist() == [5000]
    assert found.value[-1] == 19_999 / 8


def test_all_columns_of_numbers(tmp_path: Path) -> None:
    path = tmp_path / "rig.csv"
    path.write_text("t;a;state;b\ns;Nm;-;N\n0;1,5;on;1\n1;2,5;off;2\n2;3,5;x;oops\n", "utf-8")
    found = read_table(path)
    assert {name: one.tolist() for name, one in found.items()} == {
        "t": [0.0, 1.0, 2.0],
        "a": [1.5, 2.5, 3.5],
    }
