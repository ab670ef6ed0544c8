"""An array of numbers that grows at its end without a second copy of itself.

Beyond :data:`IN_MEMORY` numbers it lies in a file without a name, in the folder of temporary files
(``TMPDIR``, else ``/var/tmp``), which the system pages in and out: a log of a night does not have
to fit into memory. The file is gone with the array, or with the process.
"""

import mmap
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from eps_hil.errors import EpsHilError

_ROOM = 4096
_BLOCK = 1 << 20
IN_MEMORY = 1 << 22
"""Numbers that are kept in memory: 32 MB, 1.2 h of one signal at 1 kHz."""


class Growing:
    """Numbers of one type, (n,); large ones are moved by the system's tables, not copied."""

    def __init__(self, kind: type[np.generic]) -> None:
        self._numbers: npt.NDArray[Any] = np.empty(_ROOM, kind)
        self._used = 0
        self._file: IO[bytes] | None = None
        self._map: mmap.mmap | None = None

    def __len__(self) -> int:
        return self._used

    def add(self, more: npt.NDArray[Any]) -> None:
        """Put ``more`` (m,) at the end. :class:`EpsHilError` where the disk is full."""
        need = self._used + len(more)
        if need > len(self._numbers):
            if need <= IN_MEMORY:
                self._numbers.resize(need + need // 8, refcheck=False)
            else:
                self._to_file(need + need // 8)
        self._numbers[self._used : need] = more
        self._used = need

    def whole(self) -> npt.NDArray[Any]:
        """All of them; nothing can be added then."""
        if self._map is None:
            self._numbers.resize(self._used, refcheck=False)
            return self._numbers
        return self._numbers[: self._used]

    def _to_file(self, room: int) -> None:
        """Room for so many numbers in the file; claimed now, so that none is missing later."""
        kind, size = self._numbers.dtype, room * self._numbers.itemsize
        folder = _folder()
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - lives as long as this
            os.posix_fallocate(self._file.fileno(), 0, size)
        except OSError as error:
            problem = f"{folder or tempfile.gettempdir()}: {error.strerror}"
            remedy = "a long log needs room for its signals; set TMPDIR to a folder that has it"
            raise EpsHilError(f"{problem}: {remedy}") from None
        if self._map is None:
            before = self._numbers[: self._used]
            self._map = mmap.mmap(self._file.fileno(), size)
            self._numbers = np.frombuffer(self._map, kind)
            self._numbers[: self._used] = before
        else:
            self._numbers = np.empty(0, kind)  # nothing may point into what is moved
            self._map.resize(size)
            self._numbers = np.frombuffer(self._map, kind)


def blocks(n: int) -> Iterator[slice]:
    """``n`` numbers bit by bit, so that what is made of them on the way stays small."""
    for begin in range(0, n, _BLOCK):
        yield slice(begin, min(begin + _BLOCK, n))


def _folder() -> str | None:
    """Where large temporary files belong: not where that may be memory, unless asked for."""
    if "TMPDIR" not in os.environ and Path("/var/tmp").is_dir():
        return "/var/tmp"
    return None
