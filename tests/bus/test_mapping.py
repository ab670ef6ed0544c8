from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.bus.mapping import load_mapping
from eps_hil.errors import InputError
from eps_hil.signals import CANONICAL

RIG = Path(__file__).parents[2] / "configs" / "eps_rig_signals.yaml"
SPEED = "signals:\n  motor_speed_rad_s: {message: M, signal: S}\n"


def write(folder: Path, text: str) -> Path:
    path = folder / "mapping.yaml"
    path.write_text(text)
    return path


def failure(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_mapping(path)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(str(path))
    return text


def test_the_rig_mapping_covers_every_canonical_signal() -> None:
    mapping = load_mapping(RIG)
    assert set(mapping.signals) == set(CANONICAL)
    assert mapping.sync_message == "EPS_MotorState"
    assert {n for n, rules in mapping.messages.items() if rules.clock == "counter"} == {
        "EPS_MotorState",
        "EPS_Torques",
        "RIG_State",
    }


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", ["signals", "missing"]),
        ("just a word", ["signals", "missing"]),
        ("signals: {}", ["line 1", "signals"]),
        ("signals:\n  - [\n", ["line 3", "column", "not valid YAML"]),
        (
            "signals:\n  motor_sped_rad_s: {message: M, signal: S}",
            ["line 2", "signals.motor_sped_rad_s:", "nearest: motor_speed_rad_s"],
        ),
        ("signals:\n  motor_speed_rad_s: {message: M}", ["line 2", "both message and signal"]),
        ("signals:\n  motor_speed_rad_s: 3", ["line 2", "motor_speed_rad_s"]),
        (
            "signals:\n  motor_speed_rad_s: {message: M, signal: S, scale: fast}",
            ["line 2", "scale", "valid number"],
        ),
        (
            "signals:\n  motor_speed_rad_s: {message: M, signal: S, scale: 0}",
            ["line 2", "must not be zero"],
        ),
        (
            "signals:\n  motor_speed_rad_s: {message: M, signal: S, offset: .nan}",
            ["line 2", "offset", "finite"],
        ),
        (
            "signals:\n  motor_speed_rad_s: {message: M, signal: S, gain: 1}",
            ["line 2", "gain: is not a known field"],
        ),
        (
            "signals:\n  motor_speed_rad_s: {column: n_rotor}",
            ["signals", "maps columns of a table, not signals of a database"],
        ),
        (
            "signals:\n  motor_speed_rad_s: {derive_from: motor_angle_rad}",
            ["motor_angle_rad", "is not mapped"],
        ),
        (
            SPEED + "  yaw_rate_rad_s: {derive_from: motor_speed_rad_s}",
            ["signals.yaw_rate_rad_s", "only motor_speed_rad_s can be derived"],
        ),
        (
            "signals:\n  motor_speed_rad_s:\n"
            "    {message: M, signal: S, derive_from: motor_angle_rad}",
            ["not both"],
        ),
        (SPEED.replace("S}", "S, window_s: 0.1}"), ["window_s belongs to derive_from"]),
        (
            SPEED.replace("S}", "S, torque_constant_nm_per_a: 0.1}"),
            ["torque_constant_nm_per_a belongs to motor_torque_nm"],
        ),
        (SPEED + "messages:\n  M: {clock: counter}", ["line 4", "name of the counter signal"]),
        (
            SPEED + "messages:\n  M: {crc: C, crc_profile: j1850}",
            ["line 4", "unknown CRC profile", "sae_j1850"],
        ),
        (SPEED + "messages:\n  M: {crc: C, crc_data_id: 65536}", ["line 4", "crc_data_id"]),
        (SPEED + "sink: M", ["line 3", "sink: is not a known field"]),
    ],
)
def test_a_mistake_is_told_in_one_line(tmp_path: Path, text: str, said: list[str]) -> None:
    told = failure(write(tmp_path, text))
    for part in said:
        assert part in told


def test_missing_file(tmp_path: Path) -> None:
    assert "no such file" in failure(tmp_path / "none.yaml")


@given(content=st.binary(max_size=200))
def test_random_bytes_are_an_input_error(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "random.yaml"
    path.write_bytes(content)
    failure(path)


def test_sync_defaults_to_the_message_of_speed_then_angle(tmp_path: Path) -> None:
    angle = "  motor_angle_rad: {message: A, signal: S}\n"
    derived = "signals:\n  motor_speed_rad_s: {derive_from: motor_angle_rad, window_s: 0.05}\n"
    assert load_mapping(write(tmp_path, SPEED + angle)).sync_message == "M"
    mapping = load_mapping(write(tmp_path, derived + angle))
    assert mapping.sync_message == "A"
    assert mapping.signals["motor_speed_rad_s"].window_s == 0.05
    torque = "signals:\n  motor_torque_nm: {message: T, signal: S}\n"
    assert load_mapping(write(tmp_path, torque)).sync_message is None
    assert load_mapping(write(tmp_path, torque + "sync: X")).sync_message == "X"
