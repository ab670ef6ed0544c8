"""CAN interfaces as iproute2 describes them (``ip -details -json link show``), and their lines."""

import shutil
from types import SimpleNamespace

import pytest

from eps_hil.selftest import can_interface
from eps_hil.selftest.can_interface import (
    Interface,
    interface_of,
    judge_interface,
    judge_kernel,
    load_bit_s,
)
from eps_hil.selftest.check import Check, Verdict

VCAN = {"ifname": "vcan0", "flags": ["NOARP", "UP", "LOWER_UP"], "mtu": 72, "txqlen": 1000,
        "linkinfo": {"info_kind": "vcan"}}  # fmt: skip
CAN = {
    "ifname": "can0", "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"], "mtu": 16, "txqlen": 10,
    "linkinfo": {
        "info_kind": "can",
        "info_data": {
            "ctrlmode": ["BERR-REPORTING"], "state": "ERROR-ACTIVE", "restart_ms": 100,
            "bittiming": {"bitrate": 1_000_000, "sample_point": "0.750"}, "clock": 80_000_000,
        },
    },
}  # fmt: skip


@pytest.fixture(autouse=True)
def no_ethtool(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can_interface, "hardware_stamps", lambda _: None)


def changed(**values: object) -> Interface:
    info = CAN["linkinfo"]["info_data"] | values  # type: ignore[index]
    return interface_of("can0", CAN | {"linkinfo": {"info_kind": "can", "info_data": info}})


def by_id(lines: list[Check]) -> dict[str, Check]:
    return {each.id: each for each in lines}


def test_a_controller_and_a_virtual_interface_are_read() -> None:
    one = interface_of("can0", CAN)
    assert one == Interface("can0", True, False, 16, 10, "ERROR-ACTIVE", 1_000_000, 100, True, None)
    virtual = interface_of("vcan0", VCAN)
    assert virtual.virtual
    assert virtual.restart_ms is None


def test_a_good_controller() -> None:
    lines = by_id(judge_interface("can0", [interface_of("can0", CAN)], 480e3))
    assert {each.verdict for each in lines.values()} == {Verdict.GOOD, Verdict.TOLD}
    assert "48% used" in lines["bitrate"].measured


@pytest.mark.parametrize(
    ("values", "id", "verdict"),
    [
        ({"state": "BUS-OFF"}, "interface", Verdict.LIMITED),
        ({"state": "ERROR-PASSIVE"}, "interface", Verdict.LIMITED),
        ({"restart_ms": 0}, "restart_ms", Verdict.LIMITED),
        ({"restart_ms": None}, "restart_ms", Verdict.LIMITED),
        ({"bittiming": {"bitrate": 500_000}}, "bitrate", Verdict.NOT_GOOD),
        ({"bittiming": {}}, "bitrate", Verdict.UNKNOWN),
        ({"ctrlmode": []}, "berr_reporting", Verdict.TOLD),
    ],
)
def test_a_controller_with_one_shortcoming(
    values: dict[str, object], id: str, verdict: Verdict
) -> None:
    lines = by_id(judge_interface("can0", [changed(**values)], 480e3))
    assert lines[id].verdict == verdict
    if verdict in {Verdict.LIMITED, Verdict.NOT_GOOD}:
        assert lines[id].remedy


def test_a_long_send_queue_holds_old_frames() -> None:
    long = interface_of("can0", CAN | {"txqlen": 1000})
    assert by_id(judge_interface("can0", [long], 1.0))["txqueuelen"].verdict == Verdict.LIMITED
    virtual = by_id(judge_interface("vcan0", [interface_of("vcan0", VCAN)], 1.0))
    assert virtual["txqueuelen"].verdict == Verdict.TOLD
    assert "bitrate" not in virtual


def test_an_interface_that_is_missing_or_down() -> None:
    (missing,) = judge_interface("can1", [interface_of("can0", CAN)], 1.0)
    (down,) = judge_interface("can0", [interface_of("can0", CAN | {"flags": []})], 1.0)
    assert (missing.verdict, missing.measured) == (Verdict.NOT_GOOD, "does not exist")
    assert (down.verdict, down.measured) == (Verdict.NOT_GOOD, "is down")
    assert "ip link" in missing.remedy


def test_a_kernel_without_can_counts_only_where_it_is_asked_for() -> None:
    refused = "Address family not supported by protocol"
    assert judge_kernel(refused, [], wanted=True).verdict == Verdict.NOT_GOOD
    assert judge_kernel(refused, [], wanted=False).verdict == Verdict.TOLD
    assert judge_kernel("", [], wanted=True).verdict == Verdict.GOOD


def test_without_ip_the_interfaces_come_from_sys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    assert can_interface._ip_links() == []


def test_the_load_of_messages() -> None:
    """1,000 frames a second of 8 bytes: 111 to 135 bits each, and 20 more with 29-bit ids."""
    message = SimpleNamespace(length=8, is_extended_frame=False)
    assert load_bit_s([(message, 1e-3), (message, None)]) == 123_000.0
    long = SimpleNamespace(length=8, is_extended_frame=True)
    assert load_bit_s([(long, 1e-3)]) == 143_000.0
