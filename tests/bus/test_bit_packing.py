"""Packed by shifts, a payload is the one that cantools makes."""

from pathlib import Path
from typing import Any

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.bus.bit_packing import packing_of
from eps_hil.bus.database import load_database

ROOT = Path(__file__).parents[2]
DATABASES = [
    load_database([file])
    for file in (ROOT / "dbc" / "eps_rig.dbc", *sorted((ROOT / "configs").rglob("*.dbc")))
]
MESSAGES = [message for database in DATABASES for message in database.messages]


@given(data=st.data())
@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.name)
def test_bytes_are_those_of_cantools(message: Any, data: st.DataObject) -> None:
    packing = packing_of(message)
    assert packing is not None
    raw = {
        s.name: data.draw(
            st.integers(-(2 ** (s.length - 1)), 2 ** (s.length - 1) - 1)
            if s.is_signed
            else st.integers(0, 2**s.length - 1)
        )
        for s in message.signals
    }
    assert packing.pack(raw) == message.encode(raw, scaling=False, strict=False)
    assert packing.unpack(packing.pack(raw)) == raw


def described(signals: str, length: int = 8) -> Any:
    text = f'VERSION ""\nBU_: X\nBO_ 1 M: {length} X\n{signals}\n'
    database: Any = cantools.database.load_string(text, "dbc")
    return database.messages[0]


@given(st.integers(-4, 3), st.integers(0, 2**13 - 1), st.integers(0, 2**33 - 1))
def test_big_endian_signals_across_bytes(first: int, second: int, third: int) -> None:
    message = described(
        ' SG_ A : 6|3@0- (1,0) [0|0] "" X\n SG_ B : 12|13@0+ (1,0) [0|0] "" X\n'
        ' SG_ C : 37|33@0+ (1,0) [0|0] "" X',
        9,
    )
    packing = packing_of(message)
    assert packing is not None
    raw = {"A": first, "B": second, "C": third}
    assert packing.pack(raw) == message.encode(raw, scaling=False, strict=False)
    assert packing.unpack(packing.pack(raw)) == raw


def test_what_shifts_do_not_do_is_left_to_cantools() -> None:
    both = described(' SG_ A : 0|8@1+ (1,0) [0|0] "" X\n SG_ B : 15|8@0+ (1,0) [0|0] "" X')
    assert packing_of(both) is None
    several = described(' SG_ A M : 0|8@1+ (1,0) [0|0] "" X\n SG_ B m0 : 8|8@1+ (1,0) [0|0] "" X')
    assert packing_of(several) is None
    assert packing_of(described(' SG_ A : 0|32@1- (1,0) [0|0] "" X\nSIG_VALTYPE_ 1 A : 1;')) is None
