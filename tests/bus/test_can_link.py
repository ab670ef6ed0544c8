"""The controller's state by the kernel's own word, and a restart out of bus-off."""

import struct

import pytest

from eps_hil.bus.can_link import CanLink, can_link, read_link, restart
from eps_hil.bus.port import BusState, open_port


def attribute(kind: int, value: bytes) -> bytes:
    return struct.pack("=HH", 4 + len(value), kind) + value + bytes(-len(value) % 4)


def link(kind: bytes, data: bytes) -> bytes:
    """RTM_NEWLINK as ``ip link show`` gets it, its other attributes in front."""
    details = attribute(1, kind + b"\0") + attribute(2, data)
    body = struct.pack("=BBHiII", 0, 0, 280, 3, 0x41, 0) + attribute(3, b"can0\0")
    body += attribute(18 | 0x8000, details)  # NLA_F_NESTED, as newer kernels set it
    return struct.pack("=IHHII", 16 + len(body), 16, 0, 1, 0) + body


@pytest.mark.parametrize(
    ("number", "state"),
    [
        (0, BusState.ERROR_ACTIVE),
        (1, BusState.ERROR_WARNING),
        (2, BusState.ERROR_PASSIVE),
        (3, BusState.BUS_OFF),
        (4, BusState.UNKNOWN),  # stopped
    ],
)
def test_state_of_a_controller(number: int, state: BusState) -> None:
    clock = attribute(3, struct.pack("=I", 8_000_000))
    data = clock + attribute(4, struct.pack("=I", number)) + attribute(6, struct.pack("=I", 0))
    assert read_link(link(b"can", data)) == CanLink("can", state, restarts_itself=False)


def test_a_kernel_that_restarts_by_itself_is_known_by_its_restart_ms() -> None:
    data = attribute(4, struct.pack("=I", 3)) + attribute(6, struct.pack("=I", 100))
    found = read_link(link(b"can", data))
    assert found is not None
    assert found.restarts_itself


@pytest.mark.parametrize("answer", [b"", bytes(31), link(b"veth", b""), link(b"can", b"\x02\x00")])
def test_what_does_not_tell_a_state_is_none(answer: bytes) -> None:
    assert read_link(answer) is None


def test_no_such_interface() -> None:
    assert can_link("nosuch0") is None
    assert not restart("nosuch0")


def test_an_interface_that_is_no_can_has_no_state() -> None:
    assert can_link("lo") is None


@pytest.mark.socketcan
def test_a_virtual_bus_has_no_errors_until_an_error_frame_says_so(vcan: str) -> None:
    found = can_link(vcan)
    assert found == CanLink("vcan", BusState.ERROR_ACTIVE, True)
    assert found.virtual
    port = open_port("socketcan", vcan)
    assert port.state is BusState.ERROR_ACTIVE
    port.close()
    assert not restart(vcan)  # there is nothing to restart
