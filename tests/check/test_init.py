"""``eps-hil init``: what it guesses of databases and tables, against what they are."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from eps_hil.bus.mapping import load_mapping
from eps_hil.check.check import check
from eps_hil.check.guess import Candidate, guess, words
from eps_hil.cli.main import main
from eps_hil.examples import CONFIGS, DBC
from eps_hil.recordings.foreign import load_columns, read_foreign
from eps_hil.service.config import load_config


def test_the_projects_own_database_is_mapped_as_by_hand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["init", str(DBC / "eps_rig.dbc"), str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "signs: a database does not say them" in said
    guessed = load_mapping(tmp_path / "signals.yaml")
    by_hand = load_mapping(CONFIGS / "eps_rig_signals.yaml")
    published = {"rack_force_estimate_n", "friction_torque_nm"}
    assert set(guessed.signals) == set(by_hand.signals) - published
    for name, source in guessed.signals.items():
        assert source == by_hand.signals[name], name
    assert guessed.rules("EPS_MotorState").counter == "Counter"
    assert guessed.rules("EPS_MotorState").clock == "counter"
    assert check(tmp_path / "rig.yaml").good
    assert main(["init", str(DBC / "eps_rig.dbc"), str(tmp_path)]) == 2  # never over one's own
    capsys.readouterr()
    for place in (tmp_path / "rig.yaml" / "below", Path("/proc/nowhere")):
        assert main(["init", str(DBC / "eps_rig.dbc"), str(place)]) == 2
        said = capsys.readouterr().err
        assert said.startswith(f"eps-hil: {place}: DIR: cannot be made: ")
        assert said.endswith("; choose another folder\n")


def test_a_database_that_contradicts_itself_is_written_as_it_was_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing could be begun with: every other verb read the database strictly."""
    text = (DBC / "eps_rig.dbc").read_text(encoding="cp1252")
    place = text.index(" SG_ MotorSpeed ")
    odd = text[:place] + ' SG_ Odd : 0|16@1+ (1,0) [0|0] "" X\n' + text[place:]
    (tmp_path / "odd.dbc").write_text(odd, encoding="cp1252")
    assert main(["init", str(tmp_path / "odd.dbc"), str(tmp_path / "rig")]) == 0
    said = capsys.readouterr().out
    assert "not known: which of it is right: inconsistent database: " in said
    assert "overlapping" in said
    assert not load_mapping(tmp_path / "rig" / "signals.yaml").strict
    found = check(tmp_path / "rig" / "rig.yaml")
    assert found.good, found.remarks
    assert main(["init", str(DBC / "eps_rig.dbc"), str(tmp_path / "good")]) == 0
    assert load_mapping(tmp_path / "good" / "signals.yaml").strict


def test_a_database_without_a_rotor_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", str(DBC / "ford_gt350.dbc"), "nowhere"]) == 2
    assert "no signal looks like the rotor's speed or angle" in capsys.readouterr().err
    assert not Path("nowhere").exists()


def test_names_of_other_houses() -> None:
    assert {"motor", "speed", "motorspeed"} <= words("EPS_MotorSpeed_rpm")
    found = guess(
        [
            Candidate("EPS_Mot_Spd", "rpm"), Candidate("EPS_MotorTrqTarget", "Nm"),
            Candidate("EPS_MotorTrq", "Nm"), Candidate("WheelSpeedFL", "km/h"),
            Candidate("TorsionBarTrq", "Nm"), Candidate("RackForce", "kN"),
            Candidate("VehSpd", "km/h"), Candidate("MotorSpeedLimit", "rpm"),
        ]
    )  # fmt: skip
    assert {name: one.of.name for name, one in found.items()} == {
        "motor_speed_rad_s": "EPS_Mot_Spd", "motor_torque_nm": "EPS_MotorTrq",
        "torque_sensor_nm": "TorsionBarTrq", "rack_force_n": "RackForce",
        "vehicle_speed_m_s": "VehSpd",
    }  # fmt: skip
    assert found["rack_force_n"].scale == 1e3
    assert found["motor_speed_rad_s"].scale == pytest.approx(np.pi / 30)


def test_the_message_says_what_the_name_does_not() -> None:
    found = guess(
        [
            Candidate("TrqAct", "Nm", "MotorStatus"), Candidate("SpdAct", "rpm", "MotorStatus"),
            Candidate("Alive", None, "MotorStatus"), Candidate("TrqTorsionBar", "Nm", "Column"),
            Candidate("SpdAct", "km/h", "Body"), Candidate("TrqReq", "Nm", "MotorRequest"),
        ]
    )  # fmt: skip
    assert {name: (one.of.message, one.of.name) for name, one in found.items()} == {
        "motor_speed_rad_s": ("MotorStatus", "SpdAct"),
        "motor_torque_nm": ("MotorStatus", "TrqAct"),
        "torque_sensor_nm": ("Column", "TrqTorsionBar"),
    }
    plain = guess([Candidate("MotorSpeed", "rpm", "Status")])["motor_speed_rad_s"]
    assert found["motor_speed_rad_s"].sure < plain.sure - 0.1


def test_two_that_fit_alike_are_less_sure() -> None:
    one = guess([Candidate("MotorSpeed", "rpm")])["motor_speed_rad_s"]
    two = guess([Candidate("MotorSpeed1", "rpm"), Candidate("MotorSpeed2", "rpm")])
    assert two["motor_speed_rad_s"].sure < one.sure - 0.2


def test_a_table_with_units_and_turned_signs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t = np.arange(0.0, 5.0, 1e-3)
    speed, torque = 30.0 * np.cos(4 * t), 0.4 * np.sin(3 * t)
    table = tmp_path / "bench.csv"
    columns = (t, speed * 30 / np.pi, torque, -7.5 * np.sin(4 * t), -2.0 * torque)
    head = "Time,MotorSpeed [rpm],MotorTorque [Nm],MotorAngle [rad],RackForce [kN]"
    np.savetxt(table, np.column_stack(columns), delimiter=",", header=head, comments="")
    assert main(["init", str(table), str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "not known: the signs of motor torque and speed" in said
    read = read_foreign(table, load_columns(tmp_path / "columns.yaml"))
    assert np.allclose(read.series["motor_speed_rad_s"].value, speed, atol=1e-9)
    assert np.allclose(read.series["motor_angle_rad"].value, 7.5 * np.sin(4 * t), atol=1e-9)
    assert np.allclose(read.series["rack_force_n"].value, 2000.0 * torque, atol=1e-6)


def test_what_is_neither_a_database_nor_a_table_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "README.md"
    page.write_text("# a page: not YAML, either\n")
    assert main(["init", str(page)]) == 2
    assert "neither a CAN database nor a table" in capsys.readouterr().err


def test_names_and_paths_reach_the_files_to_the_letter(tmp_path: Path) -> None:
    """INCA's backslashes, an apostrophe, and a folder with a comma."""
    table = tmp_path / "t.csv"
    t = np.arange(300) * 1e-3
    head = "time_s,MotorSpeed\\ETKC:1 [rad/s],Driver's motor torque [Nm]"
    columns = np.column_stack([t, np.sin(t), np.cos(t)])
    np.savetxt(table, columns, delimiter=",", header=head, comments="")
    assert main(["init", str(table), str(tmp_path)]) == 0
    read = read_foreign(table, load_columns(tmp_path / "columns.yaml"))
    assert np.allclose(read.series["motor_speed_rad_s"].value, np.sin(t))
    folder = tmp_path / "cars, [2024]"
    folder.mkdir()
    dbc = shutil.copy(DBC / "eps_rig.dbc", folder)
    assert main(["init", str(dbc), str(tmp_path)]) == 0
    assert load_config(tmp_path / "rig.yaml").dbc == (folder / "eps_rig.dbc",)
