"""Lines of candump, as can-utils write them."""

import pytest

from eps_hil.bus.candump_line import candump_line
from eps_hil.bus.frame import Frame

NS = 1_757_617_431_821_276_000


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (Frame(NS + 499, 0x123, b"\xde\xad"), "(1757617431.821276) can0 123#DEAD R"),
        (Frame(NS + 500, 0x123, b""), "(1757617431.821277) can0 123# R"),
        (Frame(NS, 0x80, b"", extended=True, own=True), "(1757617431.821276) can0 00000080# T"),
        (Frame(NS, 0x123, b"\x01", fd=True, brs=True), "(1757617431.821276) can0 123##101 R"),
        (Frame(NS, 0x123, b"", fd=True, esi=True), "(1757617431.821276) can0 123##2 R"),
        (Frame(NS, 0x123, b"", remote=True), "(1757617431.821276) can0 123#R R"),
        (Frame(NS, 0x123, b"", remote=True, remote_length=8),
         "(1757617431.821276) can0 123#R8 R"),
        (Frame(NS, 0x4, bytes(8), error=True),
         "(1757617431.821276) can0 20000004#0000000000000000"),
        (Frame(NS, 0, b"", error=True), "(1757617431.821276) can0 20000080#"),
        (Frame(1_000, 0x7FF, b""), "(0.000001) can0 7FF# R"),
    ],
)  # fmt: skip
def test_each_kind_of_frame(frame: Frame, said: str) -> None:
    assert candump_line(frame, "can0") == said + "\n"
