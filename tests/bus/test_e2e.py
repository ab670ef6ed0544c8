"""AUTOSAR E2E profiles on a command frame: the package's CRC, our bookkeeping of the counter."""

from dataclasses import replace

import pytest

from eps_hil.bus.e2e import E2eProfile, E2eProtector
from eps_hil.bus.protection import CrcRule
from eps_hil.errors import EpsHilError

P01 = E2eProfile("p01", data_id=0x123)
RULES = (
    P01,
    E2eProfile("p02", data_id_list=tuple(range(1, 17))),
    E2eProfile("p05", data_id=0x1234),
    E2eProfile("p05", data_id=0x1234, offset=4),
    E2eProfile("p11", data_id=0x123, offset=1),
)
COUNTER = {"p01": (1, 0x0F), "p02": (1, 0x0F), "p05": (2, 0xFF), "p11": (1, 0x0F)}
PERIOD = {"p01": 15, "p02": 16, "p05": 256, "p11": 15}


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: f"{rule.profile}-{rule.offset}")
def test_every_frame_is_good_and_counts_on(rule: E2eProfile) -> None:
    protector = E2eProtector(rule, 8)
    place, mask = COUNTER[rule.profile]
    counters = []
    for _ in range(2 * PERIOD[rule.profile]):
        data = protector.protect(b"\xa5" * 8)
        assert protector.good(data)
        counters.append(data[rule.offset + place] & mask)
    once = counters[: PERIOD[rule.profile]]
    assert sorted(set(once)) == sorted(once), "each counter value once"
    assert counters == once * 2


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: f"{rule.profile}-{rule.offset}")
def test_a_flipped_bit_is_seen_and_the_content_is_left_alone(rule: E2eProfile) -> None:
    protector = E2eProtector(rule, 8)
    data = protector.protect(b"\xa5" * 8)
    place, mask = COUNTER[rule.profile]
    kept = [at for at in range(8) if at not in range(rule.offset, rule.offset + place + 1)]
    assert all(data[at] == 0xA5 for at in kept)
    assert data[rule.offset + place] & ~mask == 0xA5 & ~mask
    for at in kept:
        spoilt = bytearray(data)
        spoilt[at] ^= 0x04
        assert not protector.good(bytes(spoilt))


def test_profile_1_is_the_crc_that_the_rest_of_the_bus_uses() -> None:
    """Two implementations of the same CRC: the package's, and fastcrc in bus/protection.py."""
    data = E2eProtector(P01, 8).protect(b"\x00\x40" + b"torque")
    assert CrcRule.make(0, data_id=0x123).good(data)


def test_another_data_id_is_another_sender() -> None:
    data = E2eProtector(P01, 8).protect(bytes(8))
    assert not E2eProtector(replace(P01, data_id=0x124), 8).good(data)


def test_a_header_that_does_not_fit_is_refused() -> None:
    with pytest.raises(EpsHilError, match="does not fit into 4 bytes"):
        E2eProtector(E2eProfile("p05", offset=2), 4)


@pytest.mark.parametrize(
    ("profile", "listed", "offset"),
    [("p01", (1,) * 16, 0), ("p02", None, 0), ("p02", (1,) * 15, 0), ("p02", (1,) * 16, 1)],
)
def test_a_rule_that_makes_no_sense_is_refused(
    profile: str, listed: tuple[int, ...] | None, offset: int
) -> None:
    with pytest.raises(ValueError, match=r"p02|16 numbers"):
        E2eProfile(profile, data_id_list=listed, offset=offset)  # type: ignore[arg-type]
