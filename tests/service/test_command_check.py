"""What the guard allows is what the database reads in the frame, or nothing is armed."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cantools
import pytest
import yaml

from eps_hil.errors import EpsHilError
from eps_hil.service.config import load_config
from eps_hil.service.guard import Command
from eps_hil.service.override_setup import OverrideParts, prepare_override

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "configs" / "calibrate_udp.yaml"
TORQUE = ' SG_ RequestedMotorTorque : 16|24@1- (1e-06,0) [-8.388607|8.388607] "Nm" EPS_ECU'
REQUEST = ' SG_ OverrideRequest : 40|2@1+ (1,0) [0|1] "" EPS_ECU'


def prepared(
    folder: Path, override: Mapping[str, Any], lines: Mapping[str, str] | None = None
) -> OverrideParts:
    """The calibration example with other fields in its block, and other lines in its database."""
    database = (ROOT / "dbc" / "eps_rig.dbc").read_text()
    for line, other in (lines or {}).items():
        assert database.count(f"{line}\n") == 1
        database = database.replace(f"{line}\n", f"{other}\n")
    (folder / "rig.dbc").write_text(database, encoding="cp1252")
    config = yaml.safe_load(CONFIG.read_text())
    config |= {
        "dbc": [str(folder / "rig.dbc")],
        "signals": str(CONFIG.parent / config["signals"]),
        "model": str(CONFIG.parent / config["model"]),
    }
    limits = {**config["override"]["limits"], **override.get("limits", {})}
    config["override"] |= {**override, "limits": limits}
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(config))
    return prepare_override(load_config(path), path)


def read(parts: OverrideParts, folder: Path, command: Command) -> dict[str, float]:
    database: Any = cantools.database.load_file(folder / "rig.dbc")
    message = database.get_message_by_name(parts.override.command_message)
    found = message.decode(parts.command.frame(command).data, decode_choices=False)
    assert isinstance(found, dict)
    return {name: float(value) for name, value in found.items()}


def without_range(line: str) -> str:
    return re.sub(r"\[.*?\]", "[0|0]", line)


@pytest.mark.parametrize(
    ("override", "lines", "said"),
    [
        # beyond what the signal carries, where the database gives no range
        ({}, {TORQUE: without_range(TORQUE).replace("|24", "|16")}, "0.4 Nm at the rotor is 0.0"),
        ({}, {TORQUE: without_range(TORQUE).replace("@1-", "@1+")}, "-0.4 Nm at the rotor is 0 Nm"),
        (
            {"torque_scale": 0.001, "torque_unit": "other"},
            {TORQUE: without_range(TORQUE).replace("Nm", "A")},
            "0.00838861",
        ),
        # another shaft, another unit
        ({"torque_scale": 0.2}, {}, "override.torque_scale: 0.2 Nm at the rotor for 1 Nm"),
        ({"torque_scale": 1.0}, {TORQUE: TORQUE.replace("Nm", "mNm")}, "0.001 where that is"),
        ({"torque_scale": 0.1}, {TORQUE: TORQUE.replace("Nm", "N·m")}, "for 1 N·m of Req"),
        ({"torque_scale": 0.1}, {TORQUE: TORQUE.replace("Nm", "N-m")}, "for 1 N-m of Req"),
        ({"torque_scale": 0.1, "torque_unit": "Nm"}, {TORQUE: TORQUE.replace("Nm", "")}, "1 Nm"),
        # a unit that nobody knows
        ({}, {TORQUE: TORQUE.replace("Nm", "")}, "override.torque_unit: is missing, and '' of"),
        ({}, {TORQUE: TORQUE.replace("Nm", "%")}, "and '%' of RequestedMotorTorque is no known"),
        ({"torque_unit": "A"}, {TORQUE: TORQUE.replace("Nm", "")}, "torque_unit: A is no unit of"),
        ({"torque_unit": "mNm"}, {}, "torque_unit: RequestedMotorTorque is in Nm by the database"),
        # zero that is none, steps that are too coarse
        ({}, {TORQUE: TORQUE.replace("(1e-06,0)", "(0.01,0.005)")}, "0 Nm at the rotor is"),
        ({}, {TORQUE: TORQUE.replace("1e-06", "0.1")}, "one step of RequestedMotorTorque is 0.1"),
        # requests
        ({"release_value": 7}, {}, "override.release_value: 7 is 1 in OverrideRequest"),
        ({"enable_value": 9}, {}, "override.enable_value: 9 is 1 in OverrideRequest"),
        ({"enable_value": 3}, {REQUEST: REQUEST.replace("0|1]", "0|3]")}, "enable_value: 3 of"),
        ({"release_value": 1}, {}, "override.release_value: 1 is the enable_value too"),
        ({"enable_value": 0, "release_value": 1}, {}, "0 of OverrideRequest is 'Release'"),
        # signals that are one, or are something else already
        ({"request_signal": "RequestedMotorTorque"}, {}, "is the torque signal too"),
        ({"request_signal": "Crc"}, {}, "override.request_signal: Crc is the CRC"),
        ({"torque_signal": "Counter"}, {}, "override.torque_signal: Counter is the counter"),
        # neighbours
        (
            {},
            {TORQUE: f'{TORQUE}\n SG_ FeedForward : 44|10@1+ (0.02,-10) [-10|10.46] "Nm" ECU'},
            "EPSHIL_TorqueOverride.FeedForward: would say -10 Nm in every command",
        ),
    ],
)  # fmt: skip
def test_a_command_that_the_database_reads_otherwise_is_refused(
    tmp_path: Path, override: dict[str, Any], lines: dict[str, str], said: str
) -> None:
    with pytest.raises(EpsHilError, match=re.escape(said)):
        prepared(tmp_path, override, lines)


@pytest.mark.parametrize("profile", ["p01", "p05", "p11"])
@pytest.mark.parametrize("offset", range(8))
def test_an_e2e_header_over_torque_or_request_is_refused(
    tmp_path: Path, profile: str, offset: int
) -> None:
    """Bytes 2 to 4 hold the torque, two bits of byte 5 the request."""
    pytest.importorskip("e2e")
    rule = {"profile": profile, "data_id": 0x80, "offset": offset}
    length = 3 if profile == "p05" else 2
    if offset + length <= 2 or (offset >= 6 and offset + length <= 8):
        parts = prepared(tmp_path, {"e2e": rule})
        for torque_nm in (0.4, -0.4, 0.123):
            said = read(parts, tmp_path, Command(torque_nm, True))
            assert said["RequestedMotorTorque"] == pytest.approx(torque_nm, abs=1e-6)
    else:
        with pytest.raises(EpsHilError, match=r"override\.e2e: (its|the) header"):
            prepared(tmp_path, {"e2e": rule})


@pytest.mark.parametrize(
    ("override", "lines", "times"),
    [
        ({}, {}, 1.0),
        ({"torque_scale": -1.0}, {}, -1.0),
        ({"torque_scale": 0.05001}, {}, 1 / 0.05001),
        (
            {"torque_scale": 0.001},
            {TORQUE: TORQUE.replace("(1e-06,0) [-8.388607|8.388607] \"", "(0.1,0) [-9e5|9e5] \"m")},
            1e3,
        ),
        ({}, {TORQUE: TORQUE.replace("16|24@1-", "23|24@0-")}, 1.0),
        ({}, {TORQUE: TORQUE.replace("Nm", "N m")}, 1.0),
        ({"torque_unit": "Nm"}, {TORQUE: TORQUE.replace("Nm", "")}, 1.0),
        ({"torque_scale": 0.1, "torque_unit": "other"}, {TORQUE: TORQUE.replace("Nm", "A")}, 10.0),
        (
            {},
            {TORQUE: f"{TORQUE}\n SG_ Spare : 44|10@1+ (0.02,0) [0|20.46] \"Nm\" ECU"},
            1.0,
        ),
    ],
)  # fmt: skip
def test_one_that_it_reads_so_is_sent(
    tmp_path: Path, override: dict[str, Any], lines: dict[str, str], times: float
) -> None:
    parts = prepared(tmp_path, override, lines)
    for torque_nm in (0.4, -0.4, 0.0, 0.0173):
        said = read(parts, tmp_path, Command(torque_nm, True))
        assert said["RequestedMotorTorque"] == pytest.approx(times * torque_nm, rel=1e-2, abs=1e-6)
        assert said["OverrideRequest"] == 1
        assert said.get("Spare", 0.0) == 0.0
    assert read(parts, tmp_path, Command(0.0, False))["OverrideRequest"] == 0


@pytest.mark.parametrize("wrong", [True, "0.4"])
def test_a_limit_is_a_number(tmp_path: Path, wrong: object) -> None:
    """``max_torque_nm: yes`` is no 1 Nm."""
    with pytest.raises(EpsHilError, match=r"override\.limits\.max_torque_nm"):
        prepared(tmp_path, {"limits": {"max_torque_nm": wrong}})
