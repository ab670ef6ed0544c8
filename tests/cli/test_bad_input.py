"""Wrong input through the command: status 2 and one line that names file, place and remedy."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.cli._files import check_model_place
from eps_hil.cli.main import main

ROOT = Path(__file__).parents[2]
HEADER = b"time_s,motor_torque_nm,motor_speed_rad_s\n"

CASES = [
    ("text.csv", HEADER + b"0,1,2\n1,abc,2\n", "line 3, column motor_torque_nm: 'abc'"),
    ("backwards.csv", HEADER + b"1,1,2\n0,1,2\n", "line 3, column time_s: time goes back"),
    ("unknown.csv", b"time_s,motor_torqe_nm\n0,1\n", "rename it to motor_torque_nm"),
    ("empty.csv", b"", "is empty"),
    ("header.csv", HEADER, "nothing follows the header"),
    ("nan.csv", HEADER + b"0,nan,2\n", "line 2, column motor_torque_nm: is NaN or infinite"),
    ("inf.csv", HEADER + b"0,1,inf\n", "line 2, column motor_speed_rad_s: is NaN or infinite"),
    ("semicolon.csv", b"time_s;motor_torque_nm\n0,5;1,5\n", "separated by a semicolon"),
    ("bytes.csv", bytes(range(256)), "line 1: holds binary data"),
    ("bytes.parquet", bytes(range(256)), "is not readable as Parquet"),
    ("bytes.mf4", bytes(range(256)), "is not readable as MF4"),
    ("bytes.blf", bytes(range(256)), "is not readable as BLF"),
    ("bytes.asc", bytes(range(256)), "holds no CAN frame"),
    ("bytes.trc", bytes(range(256)), "holds no CAN frame"),
    ("bytes.log", bytes(range(256)), "is not a candump line"),
    ("log.log", b"(1.0) can0 123#00\n", "no mapped frame occurs"),
    ("text.doc", b"text", "is no recording"),
]


@pytest.mark.parametrize(("name", "content", "expected"), CASES, ids=[case[0] for case in CASES])
def test_convert_says_what_is_wrong_in_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    name: str,
    content: bytes,
    expected: str,
) -> None:
    path, target = tmp_path / name, tmp_path / "out.csv"
    path.write_bytes(content)
    root = Path(__file__).parents[2]
    status = main(
        [
            "convert", str(path), str(target),
            "--dbc", str(root / "dbc" / "eps_rig.dbc"),
            "--signals", str(root / "configs" / "eps_rig_signals.yaml"),
        ]
    )  # fmt: skip
    captured = capsys.readouterr()
    assert status == 2
    assert captured.out == ""
    assert captured.err.startswith(f"eps-hil: {path}: ")
    assert captured.err.count("\n") == 1
    assert expected in captured.err
    assert "; " in captured.err  # a remedy follows the problem
    assert not target.exists()


def test_outputs_never_replace_each_other_nor_what_is_read(
    tmp_path: Path, weave_truth: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    model = ROOT / "configs" / "reference_rig.yaml"
    names = (
        "time_s",
        "motor_torque_nm",
        "torque_sensor_nm",
        "motor_speed_rad_s",
        "motor_angle_rad",
    )
    table = np.column_stack([weave_truth.columns[name][:3000] for name in names])
    same = [tmp_path / folder / "same.csv" for folder in ("a", "b")]
    for path in same:
        path.parent.mkdir()
        np.savetxt(path, table, delimiter=",", header=",".join(names), comments="")
    one, other = map(str, same)
    mine = tmp_path / "mine.yaml"
    mine.write_bytes(model.read_bytes())
    out = str(tmp_path / "x.csv")
    cases = {
        f"two recordings would be written to {tmp_path}/e_same.csv": [
            "estimate", one, other, "--model", str(mine), "--out", str(tmp_path / "e_{name}.csv"),
        ],
        "x.csv: is the name of two outputs": [
            "estimate", one, "--model", str(mine), "--out", out, "--json", out,
        ],
        "x.csv: is the name of two outputs; give": [
            "diagnose", "--recording", one, "--model", str(mine), "--report", out, "--json", out,
        ],
        "mine.yaml: is read by this command; write": [
            "estimate", one, "--model", str(mine), "--json", str(mine),
        ],
        "a/same.csv: is read by this command": ["clocks", one, "--json", one],
        "mine.yaml: is read by this command": [
            "diagnose", "--recording", one, "--model", str(mine), "--write-model", str(mine),
        ],
        "b/same.csv: is read by this command": [
            "changes", "--before", one, "--after", other, "--model", str(mine), "--json", other,
        ],
        "a/same.csv: is read by this command; write": [
            "compare", one, "--model", str(mine), "--json", one,
        ],
        "a/same.csv: is read by this command; write to": [
            "identify", one, "--model", str(mine), "--simulation", f"{tmp_path}/s.fmu", "--free",
            "x", "--json", one,
        ],
        "mine.yaml: is read by this command; write to": [
            "tune", "--model", str(mine), "--json", str(mine),
        ],
        "mine.yaml: is read by this command; write to another": [
            "budget", "--model", str(mine), "--report", str(mine),
        ],
        "mine.yaml: is read by this command; write to another file": [
            "check", str(mine), "--json", str(mine),
        ],
        "b/same.csv: is read by this command; write": [
            "frequency-response", one, other, "--model", str(mine), "--json", other,
        ],
    }  # fmt: skip
    before = mine.read_bytes(), same[1].read_bytes()
    for words, arguments in cases.items():
        assert main(arguments) == 2
        said = capsys.readouterr().err
        assert words in said, said
        assert said.count("\n") == 1
    assert not (tmp_path / "x.csv").exists()
    assert (mine.read_bytes(), same[1].read_bytes()) == before


@pytest.mark.parametrize(
    "verb",
    [
        ["identify", "{one}", "--model", "{model}"],
        ["diagnose", "--recording", "{one}", "--model", "{model}"],
        ["changes", "--before", "{one}", "--after", "{other}", "--model", "{model}"],
        ["calibrate", "torque-injection", "--config", "{config}"],
        ["calibrate", "error-injection", "--config", "{config}"],
        ["programme", "{one}", "--config", "{config}", "--out", "{out}"],
        ["investigate", "--config", "{config}", "--out", "{out}", "--budget", "1min"],
    ],
    ids=lambda verb: " ".join(verb[:2]).split(" -")[0],
)
def test_a_model_is_not_written_over_another_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: list[str]
) -> None:
    config = ROOT / "configs" / "calibrate_udp.yaml"
    mine, broken = tmp_path / "my_rig.yaml", tmp_path / "broken.yaml"
    one, other = tmp_path / "one.csv", tmp_path / "other.csv"
    mine.write_bytes(config.read_bytes())
    broken.write_text("model: {")
    for path in (one, other):
        path.write_bytes(HEADER + b"0,1,2\n")
    names = {
        "one": one, "other": other, "config": config, "out": tmp_path / "out",
        "model": ROOT / "configs" / "reference_rig.yaml",
    }  # fmt: skip
    words = [word.format(**names) for word in verb]
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for target in (mine, broken):
        assert main([*words, "--write-model", str(target)]) == 2
        said = capsys.readouterr()
        expected = f"eps-hil: {target}: is no model file and would be lost; name another file\n"
        assert said.err == expected
        assert "READY" not in said.out
    assert main([*words, "--write-model", str(tmp_path / "nowhere" / "m.yaml")]) == 2
    assert "does not exist" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_model_is_written_over_a_model_and_an_empty_file(tmp_path: Path) -> None:
    model, empty = tmp_path / "model.yaml", tmp_path / "empty.yaml"
    model.write_bytes((ROOT / "configs" / "reference_rig.yaml").read_bytes())
    empty.touch()
    for path in (None, model, empty, tmp_path / "new.yaml"):
        check_model_place(path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty.yaml", "model.yaml"]


@pytest.mark.parametrize(
    "words",
    [
        ["prove", "concealed", "--quick", "--out", "made"],
        ["prove", "changes", "--out", "made"],
        ["prove", "loop", "bus.log", "--config", "c.yaml", "--with", "m.yaml"],
        ["prove", "emps", "."],
        ["calibrate", "reversals", "drive.csv", "--model", "m.yaml"],
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_where_results_cannot_be_written_is_told_before_hours_of_work(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("eps_hil.axis.emps.read", lambda _: (None, None))
    for work in ("proof.run.run", "proof.changed.prove_changes", "axis.proof.prove"):
        monkeypatch.setattr(f"eps_hil.{work}", lambda *_, **__: pytest.fail("it began"))
    assert main([*words, "--json", "none/found.json"]) == 2
    said = capsys.readouterr().err
    assert (
        said
        == f"eps-hil: none/found.json: folder {tmp_path}/none does not exist; create it first\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_results_of_a_proof_may_go_to_its_own_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    def proved(out: Path, *_: object, **__: object) -> dict[str, int]:
        out.mkdir()
        return {"cases": 8}

    monkeypatch.setattr("eps_hil.proof.changed.prove_changes", proved)
    assert main(["prove", "changes", "--out", "made", "--json", "made/found.json"]) == 0
    assert '"cases": 8' in (tmp_path / "made" / "found.json").read_text()
    (tmp_path / "file").write_text("mine")
    monkeypatch.setattr("eps_hil.axis.emps.read", lambda _: (None, None))
    assert main(["prove", "emps", ".", "--traces", "file"]) == 2
