"""A counter that was there already: the same frame again, or somebody else's."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.bus.codec import FrameDecoder, FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import load_mapping
from eps_hil.bus.protection import Seen
from eps_hil.examples import CONFIGS

MS = 1_000_000
T0 = 1_790_000_000_000_000_000
DATABASE = load_database([Path(CONFIGS).parent / "dbc" / "eps_rig.dbc"])
RIG = load_mapping(CONFIGS / "eps_rig_signals.yaml")


def torques(value_nm: float, count: int) -> list[bytes]:
    encoder = FrameEncoder(DATABASE, "EPS_Torques")
    return [
        encoder.encode({"MotorTorque": value_nm, "TorsionBarTorque": 0.1}) for _ in range(count)
    ]


@given(modulo=st.sampled_from([15, 16, 256]), count=st.integers(1, 600))
def test_a_steady_count_is_new_with_every_frame(modulo: int, count: int) -> None:
    seen = Seen(modulo, MS)
    assert all(seen.again(T0 + n * MS, n % modulo, b"same") is None for n in range(count))


@pytest.mark.parametrize("kept", [2, 3, 7, 16])
def test_frames_that_were_lost_make_no_old_counter_new(kept: int) -> None:
    seen = Seen(16, MS)
    frames = [n for n in range(2000) if n % kept == 0]
    assert all(seen.again(T0 + n * MS, n % 16, bytes([n % 251])) is None for n in frames)


def test_the_same_frame_again_is_left_out_even_behind_the_next() -> None:
    found = FrameDecoder(DATABASE, RIG)
    data = torques(0.3, 40)
    for n in range(1, 40):
        assert found.decode(Frame(T0 + n * MS, 0x101, data[n]))
        if n > 1:
            assert found.decode(Frame(T0 + n * MS + 200_000, 0x101, data[n - 1])) == []
    assert found.faults["counter"] == 38
    assert found.faults["second_sender"] == found.faults["not_trusted"] == 0


@pytest.mark.parametrize("wait_us", [5, 300, 990])
def test_other_data_under_the_same_counter_are_no_good(wait_us: int) -> None:
    """A second ECU that is in step with the first: neither is to be believed."""
    found = FrameDecoder(DATABASE, RIG)
    ours, theirs = torques(0.3, 200), torques(-2.0, 200)
    for n in range(200):
        good = found.decode(Frame(T0 + n * MS, 0x101, ours[n]))
        assert [s.value for s in good] == pytest.approx([0.3, 0.1])
        if n >= 100:
            bad = found.decode(Frame(T0 + n * MS + wait_us * 1000, 0x101, theirs[n]))
            assert [s.signal for s in bad] == ["motor_torque_nm", "torque_sensor_nm"]
            assert all(math.isnan(s.value) for s in bad)
            assert all(b.t_ns > g.t_ns for b, g in zip(bad, good, strict=True))
    assert found.faults["second_sender"] == 100


def test_a_counter_that_stands_still_over_new_data_is_no_good() -> None:
    found = FrameDecoder(DATABASE, RIG)
    encoders = FrameEncoder(DATABASE, "EPS_Torques")
    first = encoders.encode({"MotorTorque": 0.0})
    found.decode(Frame(T0, 0x101, first))
    for n in range(1, 30):
        again = FrameEncoder(DATABASE, "EPS_Torques").encode({"MotorTorque": 0.01 * n})
        samples = found.decode(Frame(T0 + n * MS, 0x101, again))
        assert samples
        assert all(math.isnan(sample.value) for sample in samples)
