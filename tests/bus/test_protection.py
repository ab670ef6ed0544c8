from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.bus.protection import PROFILES, CounterCheck, CrcRule, crc_byte

PAYLOADS = st.binary(min_size=8, max_size=8)


@pytest.mark.parametrize(
    ("data_id", "frame"),
    [  # by the library autosar-e2e, profile 1, both-bytes mode; the first is the standard's
        (0x0123, "cc00000000000000"),
        (0x0100, "7a05112233445566"),
        (0x4567, "b8f1fffefdfcfbfa"),
    ],
)
def test_profile_1_agrees_with_an_independent_implementation(data_id: int, frame: str) -> None:
    assert CrcRule.make(0, "e2e_p01", data_id).good(bytes.fromhex(frame))


@pytest.mark.parametrize(
    ("profile", "check"),
    [("sae_j1850", 0x4B), ("autosar", 0xDF), ("smbus", 0xF4)],  # catalogue of check values
)
def test_plain_profiles_give_the_catalogue_value(profile: str, check: int) -> None:
    assert profile in PROFILES
    assert CrcRule.make(0, profile).expected(b"\x00123456789") == check


@given(payload=PAYLOADS, byte=st.integers(0, 7), bit=st.integers(0, 63))
def test_any_flipped_bit_is_detected(payload: bytes, byte: int, bit: int) -> None:
    rule = CrcRule.make(byte, "e2e_p01", 0x100)
    sent = payload[:byte] + bytes((rule.expected(payload),)) + payload[byte + 1 :]
    flipped = (int.from_bytes(sent, "big") ^ 1 << bit).to_bytes(8, "big")
    assert rule.good(sent)
    assert not rule.good(flipped)


@given(payload=PAYLOADS)
def test_the_same_payload_under_another_id_is_refused(payload: bytes) -> None:
    crc = CrcRule.make(0, "e2e_p01", 0x100).expected(payload)
    assert not CrcRule.make(0, "e2e_p01", 0x101).good(bytes((crc,)) + payload[1:])


@given(
    modulo=st.sampled_from([15, 16, 256]),
    start=st.integers(0, 255),
    kept=st.lists(st.integers(1, 14), min_size=1, max_size=200),
)
def test_counter_losses_are_counted_exactly(modulo: int, start: int, kept: list[int]) -> None:
    check = CounterCheck(modulo)
    counter = start % modulo
    assert check.advance(counter) == 1
    lost = 0
    for step in kept:
        counter = (counter + step) % modulo
        lost += check.advance(counter) - 1
    assert lost == sum(step - 1 for step in kept)
    assert check.advance(counter) == 0


@pytest.mark.parametrize(
    ("order", "start", "length", "byte"),
    [
        ("little_endian", 8, 8, 1),
        ("big_endian", 15, 8, 1),
        ("little_endian", 12, 8, None),
        ("big_endian", 8, 8, None),
        ("little_endian", 8, 4, None),
    ],
)
def test_a_crc_signal_must_be_one_whole_byte(
    order: str, start: int, length: int, byte: int | None
) -> None:
    assert crc_byte(SimpleNamespace(byte_order=order, start=start, length=length)) == byte
