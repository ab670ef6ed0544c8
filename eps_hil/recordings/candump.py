"""candump ``-L``/``-l`` logs: ``(1757617431.821276) can0 123#DEADBEEF``, read to the nanosecond.

Our own reader, because python-can's turns the stamp into a float and a broken line into a
``ValueError`` without its number. FD (``##``), remote (``#R``), error frames (flag 0x20000000) and
the direction letter are understood.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from eps_hil.bus.frame import Frame
from eps_hil.errors import InputError
from eps_hil.recordings.files import refused_by_system
from eps_hil.recordings.table import shown

LINE = re.compile(
    rb"\s*\((\d{1,10})\.(\d{1,9})\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    rb"(?:([Rr][0-9A-Fa-f]?)|#([0-9A-Fa-f])((?:[0-9A-Fa-f]{2}){0,64})"
    rb"|((?:[0-9A-Fa-f]{2}){0,8})(?:_[0-9A-Fa-f])?)(?:\s+([RrTt]))?\s*"
)
ERROR_FLAG, ID_MASK = 0x2000_0000, 0x1FFF_FFFF
_BRS_FLAG, _ESI_FLAG = 0x01, 0x02
_NS = 1_000_000_000


class CandumpLog:
    """One candump log; iterating gives (channel, frame) in the order of the file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._line = 0
        self._bytes = 0
        self._size = max(path.stat().st_size, 1)
        self.notes: list[str] = []

    @property
    def place(self) -> str:
        """Where in the file the last frame stood."""
        return f"line {self._line}"

    @property
    def fraction(self) -> float:
        """How much of the file has been read, 0 to 1."""
        return min(self._bytes / self._size, 1.0)

    def __iter__(self) -> Iterator[tuple[str, Frame]]:
        with refused_by_system(self._path), self._path.open("rb") as file:
            for self._line, line in enumerate(file, start=1):
                self._bytes += len(line)
                match = LINE.fullmatch(line)
                if match is not None:
                    yield _frame(*match.groups())
                elif line.strip() and not self._cut_off(line):
                    problem = f"{shown(line.decode('latin-1').strip())} is not a candump line"
                    remedy = "expected like (1757617431.821276) can0 123#DEADBEEF"
                    raise InputError(self._path, self.place, problem, remedy)

    def _cut_off(self, line: bytes) -> bool:
        """A last line without its end: the logger was stopped in the middle of it."""
        if line.endswith(b"\n") or self._line == 1:
            return False
        self.notes.append(f"line {self._line} is cut off: left out")
        return True


def _frame(
    seconds: bytes,
    fraction: bytes,
    channel: bytes,
    identifier: bytes,
    remote: bytes | None,
    fd_flags: bytes | None,
    fd_data: bytes | None,
    data: bytes | None,
    direction: bytes | None,
) -> tuple[str, Frame]:
    can_id, flags = int(identifier, 16), int(fd_flags or b"0", 16)
    payload = fd_data if fd_flags is not None else data
    return channel.decode("latin-1"), Frame(
        t_ns=int(seconds) * _NS + int(fraction.ljust(9, b"0")),
        can_id=can_id & ID_MASK,
        data=bytes.fromhex(payload.decode()) if payload else b"",
        extended=len(identifier) == 8,
        fd=fd_flags is not None,
        error=len(identifier) == 8 and bool(can_id & ERROR_FLAG),
        own=direction in (b"T", b"t"),
        remote=remote is not None,
        brs=bool(flags & _BRS_FLAG),
        esi=bool(flags & _ESI_FLAG),
        remote_length=min(int(remote[1:] or b"0", 16), 8) if remote else 0,
    )
