"""Raw numbers by columns against cantools, for any layout that it takes."""

from collections import OrderedDict

import numpy as np
import pytest
from cantools.database import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.bus.bits import bits_of
from eps_hil.bus.column_decoder import expected_crc
from eps_hil.bus.protection import PROFILES, CrcRule
from eps_hil.bus.signal_codec import ReadSignal

NUMBERS = st.one_of(
    st.integers(-1000, 1000).filter(bool),
    st.floats(-1e3, 1e3).filter(lambda x: abs(x) > 1e-9),
)


@st.composite
def messages(draw: st.DrawFn) -> Message:
    """One signal anywhere in a message of 1 to 64 bytes."""
    length = draw(st.sampled_from([1, 2, 3, 7, 8, 12, 64]))
    width = draw(st.integers(1, min(64, 8 * length)))
    real = width in (16, 32, 64) and draw(st.booleans())
    little = draw(st.booleans())
    free = draw(st.integers(0, 8 * length - width))
    start = free if little else 8 * (free // 8) + 7 - free % 8  # of its highest bit
    conversion = BaseConversion.factory(draw(NUMBERS), draw(NUMBERS), None, real)
    signal = Signal(
        "S", start, width, "little_endian" if little else "big_endian",
        is_signed=draw(st.booleans()), conversion=conversion,
        minimum=draw(st.none() | st.integers(-2000, 0)), maximum=draw(st.none() | st.just(5000)),
    )  # fmt: skip
    return Message(0x100, "M", length, [signal])


def raw_of(message: Message, payload: bytes) -> float:
    found = message.decode(payload, decode_choices=False, scaling=False)
    assert isinstance(found, dict)
    number = found["S"]
    assert isinstance(number, int | float)
    return number


@settings(deadline=None, max_examples=300)
@given(message=messages(), data=st.data())
def test_any_layout_reads_as_cantools_does(message: Message, data: st.DataObject) -> None:
    size = st.binary(min_size=message.length, max_size=message.length)
    payloads = data.draw(st.lists(size, min_size=1, max_size=8))
    signal = message.signals[0]
    bits = bits_of(signal, message.length)
    if bits is None:
        assert signal.length > 56  # more than eight bytes
        return
    columns = np.frombuffer(b"".join(payloads), np.uint8).reshape(len(payloads), -1)
    raw = bits.raw(columns)
    by_cantools = [raw_of(message, payload) for payload in payloads]
    assert np.array_equal(raw, np.array(by_cantools, raw.dtype), equal_nan=raw.dtype.kind == "f")
    read = ReadSignal(signal, "rack_force_n", 0.25, -3.0)
    values, none = read.read_all(raw)
    one_by_one = np.array([read.read(each) for each in by_cantools])
    assert values.tobytes() == one_by_one.tobytes()
    said = [np.isnan(v) and read.why_not(r) == "not_available"
            for v, r in zip(one_by_one, by_cantools, strict=True)]  # fmt: skip
    assert (none & np.isnan(values)).tolist() == said


def test_values_that_are_none() -> None:
    conversion = BaseConversion.factory(0.5, 0, OrderedDict({255: "Signal not available"}), False)
    signal = Signal("S", 0, 8, conversion=conversion, maximum=100)
    values, none = ReadSignal(signal, "rack_force_n", 2.0, 1.0).read_all(np.array([255, 10, 240]))
    assert np.array_equal(values, [np.nan, 11.0, np.nan], equal_nan=True)
    assert none.tolist() == [True, False, False]


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("byte", [0, 3, 7])
def test_any_crc(profile: str, byte: int) -> None:
    rule = CrcRule.make(byte, profile, 0x1234)
    data = np.random.default_rng(7).integers(0, 256, (50, 8), np.uint8)
    table = np.array(rule.table(data.shape[1]), np.uint8)
    assert expected_crc(table, data).tolist() == [rule.expected(row.tobytes()) for row in data]
