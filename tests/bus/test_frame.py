"""A frame survives every form that it takes on its way."""

import dataclasses
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.bus import socketcan, udp_multicast
from eps_hil.bus.frame import EXTENDED_ID_MAX, STANDARD_ID_MAX, Frame
from eps_hil.bus.python_can import from_message, to_message
from eps_hil.errors import BusError

FD_LENGTHS = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64]


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    extended, fd = draw(st.booleans()), draw(st.booleans())
    length = draw(st.sampled_from(FD_LENGTHS)) if fd else draw(st.integers(0, 8))
    remote = not fd and length == 0 and draw(st.booleans())
    return Frame(
        t_ns=draw(st.integers(1, 2**60)),
        can_id=draw(st.integers(0, EXTENDED_ID_MAX if extended else STANDARD_ID_MAX)),
        data=draw(st.binary(min_size=length, max_size=length)),
        extended=extended,
        fd=fd,
        remote=remote,
        brs=fd and draw(st.booleans()),
    )


@given(frames())
def test_a_python_can_message_holds_the_whole_frame(frame: Frame) -> None:
    assert from_message(to_message(frame), frame.t_ns) == frame


@given(frames())
def test_a_datagram_is_what_python_can_writes_for_the_same_message(frame: Frame) -> None:
    import can
    import msgpack
    from can.interfaces.udp_multicast.utils import unpack_message

    message: can.Message = unpack_message(udp_multicast.encode(frame), check=True)
    assert from_message(message, frame.t_ns) == frame
    assert msgpack.unpackb(udp_multicast.encode(frame)).keys() >= {"dlc", "channel", "timestamp"}


@given(frames())
def test_the_kernels_structure_is_laid_out_as_linux_can_h_says(frame: Frame) -> None:
    raw = socketcan.encode(frame, fd=True)
    assert len(raw) == (72 if frame.fd else 16)
    raw_id, length = struct.unpack_from("=IB", raw)
    assert raw_id & 0x1FFF_FFFF == frame.can_id
    assert bool(raw_id & 0x8000_0000) == frame.extended
    assert bool(raw_id & 0x4000_0000) == frame.remote
    assert raw[8 : 8 + length] == frame.data


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (Frame(0, 0x800, b""), "extended=True"),
        (Frame(0, 0x2000_0000, b"", extended=True), "does not fit"),
        (Frame(0, 1, bytes(9)), "fd=True"),
        (Frame(0, 1, bytes(9), fd=True), "not a length of CAN FD"),
        (Frame(0, 1, bytes(-1 % 66), fd=True), "not a length of CAN FD"),
    ],
)
def test_a_frame_that_cannot_be_on_the_wire_is_refused(frame: Frame, said: str) -> None:
    with pytest.raises(BusError, match=said):
        socketcan.encode(frame, fd=True)


def test_a_frame_is_a_value() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        Frame(0, 1, b"").can_id = 2  # type: ignore[misc]
    assert len({Frame(0, 1, b"a"), Frame(0, 1, b"a")}) == 1


def test_filters_take_short_ids_in_either_format() -> None:
    packed = socketcan.filters([0x123, 0x12345])
    assert struct.unpack("=4I", packed) == (0x123, 0x1FFF_FFFF, 0x8001_2345, 0x9FFF_FFFF)
    with pytest.raises(BusError, match="512"):
        socketcan.filters(range(513))


def test_a_hardware_clock_is_moved_onto_the_epoch_by_its_lowest_latency() -> None:
    clock = socketcan.HardwareClock(drift_ppm=100.0)
    epoch, latencies = 1_700_000_000_000_000_000, [90_000, 20_000, 500_000, 25_000]
    seen = [
        clock.to_epoch_ns(1_000_000 * k, epoch + 1_000_000 * k + late)
        for k, late in enumerate(latencies)
    ]
    # After the luckiest frame (20 µs late), no later frame is stamped later than 20 µs + drift.
    errors = [t - epoch - 1_000_000 * k for k, t in enumerate(seen)]
    assert errors == [90_000, 20_000, 20_100, 20_200]


@pytest.mark.parametrize("step_ns", [15_000_000, 3_600_000_000_000, -3_600_000_000_000])
def test_a_hardware_clock_follows_the_kernels_where_that_is_set(step_ns: int) -> None:
    """Set forward by an hour, as a machine hears of the time, all was stale for half a year."""
    clock, epoch = socketcan.HardwareClock(), 1_700_000_000_000_000_000
    late = []
    for k in range(1_000):
        kernel = epoch + 1_000_000 * k + 20_000 + (step_ns if k >= 500 else 0)
        late.append(kernel - clock.to_epoch_ns(1_000_000 * k, kernel))
    assert set(late[:500]) == {0}
    assert set(late[760:]) == {0}


def test_a_hardware_clock_does_not_follow_interrupts_that_are_late_for_a_while() -> None:
    clock, epoch = socketcan.HardwareClock(), 1_700_000_000_000_000_000
    for k in range(1_000):
        late = 5_000_000 if 100 <= k < 900 and k % 200 else 0
        found = clock.to_epoch_ns(1_000_000 * k, epoch + 1_000_000 * k + late)
        assert 0 <= found - epoch - 1_000_000 * k <= 50_000
