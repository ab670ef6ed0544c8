"""What the guard judges by is in the unit that the database says, or nothing is armed."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from eps_hil.errors import InputError
from eps_hil.service.config import load_config
from eps_hil.service.override_setup import OverrideParts, prepare_override

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "configs" / "calibrate_udp.yaml"
GEAR = 2513.0 / 125.7


def prepared(
    folder: Path, name: str, entry: dict[str, Any], units: dict[str, str] | None = None
) -> OverrideParts:
    """The calibration example with one signal mapped otherwise, and other units."""
    config = load_config(CONFIG)
    content = yaml.safe_load(config.signals.read_text())
    content["signals"][name] |= entry
    (folder / "signals.yaml").write_text(yaml.safe_dump(content))
    lines = config.dbc[0].read_text().splitlines()
    for signal, unit in (units or {}).items():
        row = next(k for k, line in enumerate(lines) if line.startswith(f" SG_ {signal} :"))
        head, _, tail = lines[row].split('"')
        lines[row] = f'{head}"{unit}"{tail}'
    (folder / "rig.dbc").write_text("\n".join(lines) + "\n", encoding="cp1252")
    config = replace(config, signals=folder / "signals.yaml", dbc=(folder / "rig.dbc",))
    return prepare_override(config, CONFIG)


@pytest.mark.parametrize(
    ("name", "scale", "units", "said"),
    [
        ("torque_sensor_nm", 0.05, {}, "TorsionBarTorque is in Nm, scale is 0.05; to Nm it is 1"),
        ("torque_sensor_nm", 1.0, {"TorsionBarTorque": "mNm"}, "to Nm it is 0.001"),
        ("torque_sensor_nm", -1.02, {}, "scale is -1.02; to Nm it is -1"),
        ("torque_sensor_nm", 1.0, {"TorsionBarTorque": "deg"}, "is in deg (angle)"),
        ("torque_sensor_nm", 1e-3, {"TorsionBarTorque": "MNm"}, "may be milli or mega; write mNm"),
        ("rack_position_m", 1e-3, {"RackPosition": "MM"}, "may be milli or mega; write mM"),
        ("motor_torque_nm", 0.2, {}, "to Nm it is 1 or 0.0500"),
        ("motor_speed_rad_s", 0.1, {}, "to rad/s it is 1 or 19.9"),
        ("motor_angle_rad", 1.0, {"MotorAngle": "deg"}, "to rad it is 0.01745329 or 0.34"),
        ("rack_position_m", 1.0, {"RackPosition": "cm"}, "to m it is 0.01"),
        ("rack_force_n", 0.05, {}, "RackForce is in N, scale is 0.05; to N it is 1"),
        ("rack_force_n", -1.0, {"RackForce": "kN"}, "to N it is -1000"),
        ("rack_force_n", 1.0, {"RackForce": "Nm"}, "is in Nm (torque)"),
    ],
)
def test_a_scale_that_fits_neither_unit_nor_shaft_is_refused(
    name: str, scale: float, units: dict[str, str], said: str, tmp_path: Path
) -> None:
    """A driver limit of 5 Nm let 100 Nm pass where the torsion bar counted a twentieth."""
    with pytest.raises(InputError) as caught:
        prepared(tmp_path, name, {"scale": scale}, units)
    assert f"signals.{name}: " in str(caught.value)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("name", "entry", "units"),
    [
        ("torque_sensor_nm", {"scale": -1.0}, {}),
        ("torque_sensor_nm", {"scale": 0.001}, {"TorsionBarTorque": "mN·m"}),
        ("torque_sensor_nm", {"scale": 3.0}, {"TorsionBarTorque": "V"}),
        ("torque_sensor_nm", {"scale": 0.3}, {"TorsionBarTorque": ""}),
        ("motor_torque_nm", {"scale": 1 / GEAR}, {}),
        ("motor_torque_nm", {"torque_constant_nm_per_a": 0.05}, {"MotorTorque": "A"}),
        ("motor_speed_rad_s", {"scale": -GEAR * math.pi / 180}, {"MotorSpeed": "deg/s"}),
        ("motor_angle_rad", {"scale": 2513.0}, {"MotorAngle": "m"}),
        ("rack_position_m", {"scale": 1 / 125.7}, {"RackPosition": "rad"}),
        ("rack_force_n", {"scale": -10.0}, {"RackForce": "daN"}),
        ("rack_force_n", {"scale": 2500.0}, {"RackForce": "mV"}),
        ("rack_force_n", {"scale": 250.0}, {"RackForce": "V"}),
    ],
)
def test_units_and_shafts_that_may_be_meant(
    name: str, entry: dict[str, float], units: dict[str, str], tmp_path: Path
) -> None:
    assert name in prepared(tmp_path, name, entry, units).mapping.signals
