import sys
from pathlib import Path

import pytest

from eps_hil.cli import _inputs
from eps_hil.cli.main import main

ROOT = Path(__file__).parents[2]
TABLE = "time_s,motor_torque_nm,note\n0.0,1.0,\n0.001,2.0,\n"


def test_table_to_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, target = tmp_path / "a.csv", tmp_path / "b.parquet"
    source.write_text(TABLE)
    assert main(["convert", str(source), str(target), "--ignore-unknown"]) == 0
    assert main(["convert", str(target), str(tmp_path / "c.csv")]) == 0
    assert (tmp_path / "c.csv").read_text() == "time_s,motor_torque_nm\n0.0,1.0\n0.001,2.0\n"
    captured = capsys.readouterr()
    assert captured.out.splitlines()[1].startswith(
        f"b.parquet: 2 rows of motor_torque_nm written to {tmp_path / 'c.csv'} ("
    )
    assert captured.err == f"{source}: columns left out: 'note'\n"


def test_gaps_mark_keeps_the_row(tmp_path: Path) -> None:
    source, target = tmp_path / "a.csv", tmp_path / "b.csv"
    source.write_text("time_s,motor_torque_nm\n0,1\n1,nan\n2,3\n")
    assert main(["convert", str(source), str(target)]) == 2
    assert not target.exists()
    assert main(["convert", str(source), str(target), "--gaps", "mark"]) == 0
    assert target.read_text() == "time_s,motor_torque_nm\n0.0,1.0\n1.0,\n2.0,3.0\n"


def test_log_to_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "a.log"
    log.write_text("(1.0) can0 100#0000000000000000\n(1.1) can1 100#0000000000000000\n")
    options = [
        "--dbc", str(ROOT / "dbc" / "eps_rig.dbc"),
        "--signals", str(ROOT / "configs" / "eps_rig_signals.yaml"),
    ]  # fmt: skip
    arguments = ["convert", str(log), str(tmp_path / "a.csv"), *options]
    assert main(arguments) == 2
    assert "id 0x100 is on channel can0 and on can1" in capsys.readouterr().err
    assert main([*arguments, "--channel", "can0"]) == 0
    assert (tmp_path / "a.csv").read_text().startswith("time_s,")


def test_progress_only_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    with _inputs.progress("reading") as on_progress:
        assert on_progress is None
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with _inputs.progress("reading") as on_progress:
        assert on_progress is not None
        on_progress(0.5)


def test_what_cannot_say_how_far_it_is_says_how_long_it_has_taken(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with _inputs.waiting("estimating"):
        pass
    assert capsys.readouterr().err == ""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with _inputs.waiting("estimating"):
        pass
    said = capsys.readouterr().err
    assert "estimating" in said
    assert "0:00:00" in said


def test_a_rate_has_an_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "a.csv"
    source.write_text("time_s,motor_torque_nm\n0,1\n1,2\n2,3\n")
    words = ["convert", str(source), str(tmp_path / "b.csv"), "--rate"]
    for rate in ("1e7", "1e300", "inf"):
        assert main([*words, rate]) == 2
        assert "--rate" in capsys.readouterr().err
    assert not (tmp_path / "b.csv").exists()
