"""Error frames of a candump log, which python-can takes for data frames (but bus errors).

An error of class 4 became a data frame of id 4, and was played.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from eps_hil.bus.text_lines import TextLines

_LINE = re.compile(r"\s*\(\S+\)\s+(\S+)\s+([0-9A-Fa-f]{8})#((?:[0-9A-Fa-f]{2}){0,8})(?:\s|$)")
_ERROR, _MASK = 0x2000_0000, 0x1FFF_FFFF


class _Lines(TextLines):
    """With the line that was read last."""

    last = ""

    def __next__(self) -> str:  # type: ignore[override]  # as typeshed does itself
        self.last = super().__next__()
        return self.last


def candump_reader(file: Path) -> Any:
    """python-can's reader of a candump log, with error frames as such."""
    import can

    lines = _Lines(file)

    class Reader(can.CanutilsLogReader):
        def __iter__(self) -> Iterator[can.Message]:  # type: ignore[override]
            for message in super().__iter__():
                found = _LINE.match(lines.last)
                number = int(found[2], 16) if found else 0
                if found and number & _ERROR:
                    message.is_error_frame, message.is_remote_frame = True, False
                    message.arbitration_id, message.channel = number & _MASK, found[1]
                    message.data = bytearray.fromhex(found[3])
                    message.dlc = len(message.data)
                yield message

    return Reader(lines)
