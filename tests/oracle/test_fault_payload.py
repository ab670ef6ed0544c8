"""The harness's own reader and writer of payloads, against the encoder that the product uses."""

import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.examples import CONFIGS
from eps_hil.oracle.faults.payload import Layout
from eps_hil.oracle.faults.traffic import Reader

DATABASE = load_database([CONFIGS.parent / "dbc" / "eps_rig.dbc"])


@pytest.mark.parametrize("force_n", [-26214.2, -0.2, 0.0, 761.4, 26214.2])
def test_an_estimate_frame_reads_as_it_was_encoded(force_n: float) -> None:
    encoder = FrameEncoder(DATABASE, "EPSHIL_Estimate")
    values = {
        "RackForceEstimate": force_n,
        "FrictionTorque": -0.123,
        "EstimateStatus": 3,
        "EstimateReason": 2 | 64,
        "EstimateAge": 22.5,
    }
    encoder.encode(values)
    frame = encoder.frame(values)
    read = Reader(DATABASE.get_message_by_name("EPSHIL_Estimate")).read(7, frame)
    assert read.force_n == pytest.approx(force_n)
    assert (read.status, read.reason, read.age_ms, read.counter) == (3, 66, 22.5, 1)
    assert read.good
    assert read.instant == 7 - 22_500_000


def test_a_flipped_bit_is_seen_in_the_crc() -> None:
    encoder = FrameEncoder(DATABASE, "EPSHIL_Estimate")
    frame = encoder.frame({"RackForceEstimate": 1.0})
    reader = Reader(DATABASE.get_message_by_name("EPSHIL_Estimate"))
    for bit in range(64):
        number = int.from_bytes(frame.data, "little") ^ 1 << bit
        damaged = type(frame)(0, frame.can_id, number.to_bytes(8, "little"))
        assert not reader.read(0, damaged).good


def test_changed_content_has_a_right_crc_and_leaves_the_rest() -> None:
    message = DATABASE.get_message_by_name("EPS_Torques")
    encoder = FrameEncoder(DATABASE, "EPS_Torques")
    data = encoder.encode({"MotorTorque": 0.4, "TorsionBarTorque": -1.5})
    changed = Layout.of(message).with_raw(data, MotorTorque=-8_000_000, Counter=17)
    read = message.decode(changed)
    assert read["MotorTorque"] == pytest.approx(-8.0)
    assert read["TorsionBarTorque"] == pytest.approx(-1.5)
    assert read["Counter"] == 17
    again = FrameEncoder(DATABASE, "EPS_Torques")
    for _ in range(17):
        again.encode({})
    assert changed == again.encode({"MotorTorque": -8.0, "TorsionBarTorque": -1.5})
