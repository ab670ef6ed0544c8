"""``eps-hil check``: each mistake that it knows, planted once; and the examples without one."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from eps_hil.check.check import check, kind_of
from eps_hil.check.remarks import Level
from eps_hil.cli.main import main
from eps_hil.errors import InputError
from eps_hil.examples import CONFIGS, shelf

YAML = sorted(CONFIGS.rglob("*.yaml"))


def copied(tmp_path: Path) -> Path:
    """A copy of the demo's files; the configuration's path."""
    return shelf.copy("demo_udp", tmp_path)[0].path


def change(path: Path, *keys: str, to: Any) -> None:
    content = yaml.safe_load(path.read_text())
    at = content
    for key in keys[:-1]:
        at = at[key]
    if to is None:
        del at[keys[-1]]
    else:
        at[keys[-1]] = to
    path.write_text(yaml.safe_dump(content, sort_keys=False))


def said(path: Path) -> list[str]:
    return [str(one) for one in check(path).remarks]


@pytest.mark.parametrize("path", YAML, ids=lambda path: str(path.relative_to(CONFIGS)))
def test_no_example_has_an_error(path: Path) -> None:
    found = check(path)
    assert found.good, said(path)
    schema = path.read_text().partition("\n")[0].removeprefix(shelf._EDITOR)
    assert (path.parent / schema).resolve().stem == found.kind.value


def test_the_demo_has_no_warning_and_says_what_it_will_do(tmp_path: Path) -> None:
    found = check(copied(tmp_path))
    assert {one.level for one in found.remarks} == {Level.NOTE}
    assert "note: sends 0x120, 0x121, 0x400" in [str(one) for one in found.remarks]


@pytest.mark.parametrize(
    ("keys", "to", "level", "words"),
    [
        (("bus", "options", "hop_limit"), None, "warning", "frames leave this machine"),
        (("bus",), {"interface": "socketcan", "channel": "can77"}, "warning", "no interface can77"),
        (("publish", "message"), "EPS_Torques", "error", "EPS_Torques"),
        (("rig", "order"), 7, "error", "rig.order"),
        (("estimator",), {"dead_zone_n": 1}, "error", "dead_zone_n"),
        (("investigate",), {"speed_rad_s": 500}, "error", "investigate.speed_rad_s"),
        (("override",), {"limits": {}}, "error", "max_torque_nm"),
        (("model",), "no_such.yaml", "error", "no such file"),
    ],
)
def test_a_mistake_in_the_configuration(
    tmp_path: Path, keys: tuple[str, ...], to: Any, level: str, words: str
) -> None:
    path = copied(tmp_path)
    change(path, *keys, to=to)
    assert any(line.startswith(f"{level}: ") and words in line for line in said(path)), said(path)


@pytest.mark.parametrize(
    ("keys", "to", "words"),
    [
        (("model", "delays_s"), {}, "no signal is late"),
        (("model", "inertia_kg_m2"), 0.2, "no rotor's inertia"),
        (("model", "pinion_ratio_rad_per_m"), 5000.0, "swapped"),
        (("model", "friction", "offset_pos_nm"), 2.0, "at the rotor, not at the column"),
        (("model", "effects"), [{"effect": "inertia", "scale": 1.1}] * 2, "more than once"),
    ],
)
def test_a_model_that_cannot_be_meant(
    tmp_path: Path, keys: tuple[str, ...], to: Any, words: str
) -> None:
    config = copied(tmp_path)
    change(tmp_path / "configs" / "reference_rig.yaml", *keys, to=to)
    assert any(line.startswith("warning: ") and words in line for line in said(config))


def test_a_model_that_only_a_simulated_rig_takes(tmp_path: Path) -> None:
    model = copied(tmp_path).parent / "reference_rig.yaml"
    change(model, "model", "effects", to=[{"effect": "clock_drift", "ppm": 30.0}])
    words = "'clock_drift' is of what a rig reports: every verb but rig refuses the file"
    assert said(model) == [f"note: {model}: model.effects: {words}"]


@pytest.mark.parametrize("key", ["belt_ratio", "pole_pairs", "delays_s", "effects"])
def test_a_key_of_the_model_that_is_misspelt_has_no_effect(tmp_path: Path, key: str) -> None:
    model = copied(tmp_path).parent / "reference_rig.yaml"
    wrong = f"{key[:2]}{key[3:]}"
    model.write_text(model.read_text().replace(f"  {key}:", f"  {wrong}:"))
    expected = f"'{wrong}' is read by nobody, and {key} has its default; did you mean {key}?"
    assert f"warning: {model}: model.{wrong}: {expected}" in said(model)
    model.write_text(model.read_text().replace(f"  {wrong}:", f"  x: 1\n  {key}:"))
    assert not any("read by nobody" in line for line in said(model))


def test_units_counters_and_crcs_of_the_database(tmp_path: Path) -> None:
    config = copied(tmp_path)
    signals, database = (
        tmp_path / "configs" / "eps_rig_signals.yaml",
        tmp_path / "dbc" / "eps_rig.dbc",
    )
    text = database.read_text()
    assert '"rad/s" ' in text
    database.write_text(text.replace('"rad/s" ', '"rpm" '))
    change(signals, "messages", "EPS_MotorState", to={})
    lines = "\n".join(said(config))
    assert "MotorSpeed is in rpm, scale is 1; to rad/s it is 0.1047198 or 2.09" in lines
    assert "no counter: a lost or repeated frame is not noticed" in lines
    assert "is not checked; 'crc: " in lines
    assert "and crc_profile, if it is not e2e_p01" in lines
    change(signals, "signals", "motor_torque_nm", "signal", to="TorsionBarTorque")
    change(
        signals,
        "signals",
        "motor_angle_rad",
        to={"message": "EPS_Torques", "signal": "MotorTorque"},
    )
    assert "MotorTorque is in Nm (torque); rad was expected: another signal?" in "\n".join(
        said(config)
    )


def test_a_scale_that_fits_no_shaft_is_warned_of_without_an_override_too(tmp_path: Path) -> None:
    config = copied(tmp_path)
    signals = tmp_path / "configs" / "eps_rig_signals.yaml"
    change(signals, "signals", "torque_sensor_nm", "scale", to=0.05)
    change(signals, "signals", "rack_force_n", "scale", to=0.001)
    change(signals, "signals", "vehicle_speed_m_s", "scale", to=1.0)
    lines = "\n".join(said(config))
    assert "signals.torque_sensor_nm: TorsionBarTorque is in Nm, scale is 0.05; to Nm it" in lines
    assert "signals.rack_force_n: RackForce is in N, scale is 0.001; to N it is 1" in lines
    assert "signals.vehicle_speed_m_s: VehicleSpeed is in km/h, scale is 1; to m/s it is" in lines


def test_the_verb_counts_writes_json_and_ends_with_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = copied(tmp_path)
    assert main(["check", str(path), "--json", str(tmp_path / "c.json")]) == 0
    assert "0 errors, 0 warnings" in capsys.readouterr().out
    change(path, "rig", "order", to=7)
    capsys.readouterr()
    assert main(["check", str(path), "--json", str(tmp_path / "c.json")]) == 2
    said = capsys.readouterr()
    assert "1 errors" in said.out
    assert said.err.count("\n") == 1
    assert "rig.order" in said.err
    told = json.loads((tmp_path / "c.json").read_text())["files"][0]["remarks"]
    assert [one["level"] for one in told].count("error") == 1


def test_a_file_that_is_none_of_ours(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("shopping: [milk]\n")
    with pytest.raises(InputError, match="is none of our files"):
        kind_of(path)


def test_one_number_in_both_formats_is_two_ids(tmp_path: Path) -> None:
    dbc = tmp_path / "x.dbc"
    message = 'BO_ {} {}: 8 A\n SG_ V : 0|16@1- (1,0) [0|0] "rad/s" A\n'
    text = 'VERSION ""\nNS_ :\nBS_:\nBU_: A\n' + message.format(256, "M")
    dbc.write_text(text + message.format(256 | 1 << 31, "N"))
    assert not [one for one in said(dbc) if "several" in one]
    dbc.write_text(text + message.format(256, "N"))
    assert f"warning: {dbc}: id 0x100: stands for several messages" in said(dbc)
