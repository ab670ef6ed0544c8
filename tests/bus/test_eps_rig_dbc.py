"""The project's own database: complete, fine enough for the physics, in step with its document."""

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.estimation.validity import Reason, on_the_bus
from tests.loaded import loaded

ROOT = Path(__file__).parents[2]
DATABASE = load_database([ROOT / "dbc" / "eps_rig.dbc"])
SIGNALS = [(m, s) for m in DATABASE.messages for s in m.signals]
VALUES = [(m, s) for m, s in SIGNALS if s.name not in ("Crc", "Counter")]
INERTIA_AT_RACK = 2.0e-4 * 2513.0  # N per rad/s^2: J * i_APA
ROTOR_TO_RACK = 2513.0
SENSOR_TO_RACK = 125.7


def signal(message: str, name: str) -> Any:
    return DATABASE.get_message_by_name(message).get_signal_by_name(name)


def test_every_message_is_described_timed_and_sent_by_a_node() -> None:
    nodes = {node.name for node in DATABASE.nodes}
    assert nodes == {"EPS_ECU", "RIG", "VEHICLE", "EPS_HIL"}
    for message in DATABASE.messages:
        assert message.comment
        assert message.cycle_time
        assert message.length == 8
        assert len(message.senders) == 1
        assert set(message.senders) < nodes


@pytest.mark.parametrize(("message", "value"), SIGNALS, ids=lambda part: part.name)
def test_every_signal_is_described_and_ranged(message: Any, value: Any) -> None:
    assert value.comment
    assert value.minimum < value.maximum
    if value.unit:
        assert "Quantisation" in value.comment
    assert value.receivers


def test_fast_messages_and_the_override_carry_counter_and_crc() -> None:
    fast = {m.name for m in DATABASE.messages if m.cycle_time == 1}
    assert "EPSHIL_TorqueOverride" in fast
    for name in fast:
        names = {s.name for s in DATABASE.get_message_by_name(name).signals}
        assert {"Counter", "Crc"} <= names


def test_few_frames_a_millisecond() -> None:
    fast = [m for m in DATABASE.messages if m.cycle_time == 1]
    assert sum(m.senders != ["EPS_HIL"] for m in fast) == 3
    assert sum(m.senders == ["EPS_HIL"] for m in fast) == 2


def test_resolution_is_small_in_newtons_at_the_rack() -> None:
    speed_step = signal("EPS_MotorState", "MotorSpeed").scale / 1e-3  # rad/s^2 over 1 ms
    assert speed_step * INERTIA_AT_RACK < 0.1
    assert signal("EPS_Torques", "MotorTorque").scale * ROTOR_TO_RACK < 0.01
    assert signal("EPS_Torques", "TorsionBarTorque").scale * SENSOR_TO_RACK < 0.01
    assert signal("EPS_MotorState", "MotorAngle").scale <= 1e-3
    assert signal("RIG_State", "RackPosition").scale * ROTOR_TO_RACK <= 1e-3
    assert signal("RIG_State", "RackForce").scale < 0.01
    assert signal("EPSHIL_Estimate", "RackForceEstimate").scale <= 0.2


@pytest.mark.parametrize(
    ("message", "name", "reach"),
    [
        ("EPS_MotorState", "MotorSpeed", 500.0),
        ("EPS_MotorState", "MotorAngle", 0.1 * ROTOR_TO_RACK),
        ("EPS_Torques", "MotorTorque", 6.0),
        ("EPS_Torques", "TorsionBarTorque", 10.0),
        ("EPSHIL_TorqueOverride", "RequestedMotorTorque", 6.0),
        ("RIG_State", "RackForce", 20_000.0),
        ("RIG_State", "RackPosition", 0.1),
        ("EPSHIL_Estimate", "RackForceEstimate", 20_000.0),
        ("EPSHIL_Estimate", "FrictionTorque", 1.2),  # 0.126 Nm + 5e-5 Nm/N * 20 kN
    ],
)
def test_range_covers_the_rig(message: str, name: str, reach: float) -> None:
    found = signal(message, name)
    assert found.minimum <= -reach
    assert found.maximum >= reach


def test_reason_bits_are_those_of_the_estimator() -> None:
    reason = signal("EPSHIL_Estimate", "EstimateReason")
    for bit in Reason:
        told = on_the_bus(bit)
        assert 0 < told < 2**reason.length
        if told == bit and bit.name:
            assert f"{bit.value} {bit.name.lower().replace('_', ' ')}" in reason.comment


def test_status_labels() -> None:
    labels = signal("EPSHIL_Estimate", "EstimateStatus").choices
    assert {raw: str(label) for raw, label in labels.items()} == {
        0: "off", 1: "settling", 2: "valid", 3: "invalid"
    }  # fmt: skip


@given(data=st.data())
def test_round_trip_within_half_a_quantum(data: st.DataObject) -> None:
    message, value = data.draw(st.sampled_from(VALUES))
    given_value = data.draw(st.floats(value.minimum, value.maximum))
    encoder = FrameEncoder(DATABASE, message.name)
    decoded = message.decode(encoder.encode({value.name: given_value}), decode_choices=False)
    assert decoded[value.name] == pytest.approx(given_value, abs=value.scale * 0.50001)
    assert encoder.clipped == 0


@pytest.mark.parametrize(("message", "value"), VALUES, ids=lambda part: part.name)
def test_beyond_the_range_is_clipped_and_counted(message: Any, value: Any) -> None:
    encoder = FrameEncoder(DATABASE, message.name)
    for far, limit in ((math.inf, value.maximum), (-math.inf, value.minimum)):
        decoded = message.decode(encoder.encode({value.name: far}), decode_choices=False)
        assert decoded[value.name] == pytest.approx(limit, abs=value.scale * 1e-3)
    assert encoder.clipped == 2


def test_the_document_is_in_step_with_the_database() -> None:
    reference = loaded("scripts/bus_reference.py")
    document = (ROOT / "docs" / "reference-bus.md").read_text(encoding="utf-8")
    assert document == reference.rendered(document), "run scripts/bus_reference.py"


def test_the_database_of_our_messages_is_in_step() -> None:
    text = (ROOT / "dbc" / "eps_rig.dbc").read_text(encoding="utf-8")
    file = ROOT / "dbc" / "eps_hil.dbc"
    script = loaded("scripts/bus_reference.py")
    assert file.read_text(encoding="utf-8") == script.ours(text), "run scripts/bus_reference.py"
    ours = {message.name: message for message in load_database([file]).messages}
    assert ours.keys() == {m.name for m in DATABASE.messages if m.senders == ["EPS_HIL"]}
    assert {"EPSHIL_Estimate", "EPSHIL_Verdict", "EPSHIL_Health"} < ours.keys()
    for name, message in ours.items():
        whole = DATABASE.get_message_by_name(name)
        assert (message.frame_id, message.cycle_time) == (whole.frame_id, whole.cycle_time)
        for one, other in ((message, whole), *zip(message.signals, whole.signals, strict=True)):
            said, meant = one.dbc.attributes, other.dbc.attributes
            assert {k: v.value for k, v in said.items()} == {k: v.value for k, v in meant.items()}
        assert message.comment == whole.comment
        for one, other in zip(message.signals, whole.signals, strict=True):
            for kind in ("name", "start", "length", "scale", "offset", "choices", "comment"):
                assert getattr(one, kind) == getattr(other, kind), (name, one.name, kind)


def test_bus_load_of_one_frame_is_that_of_the_standard() -> None:
    reference = loaded("scripts/bus_reference.py")
    # ISO 11898-1, base format, 8 bytes, with 3 bits of intermission: 111 bits, at most 24 stuffed
    assert reference.classic_bits(8) == (111, 135)
