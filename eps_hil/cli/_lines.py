"""Lines for a person out of a loop that waits for nobody.

A terminal that is stopped (Ctrl-S) or a full pipe would hold the loop up. What it does not take
waits here, and comes out later, or at the end. A reader that went away ends nothing.
"""

import contextlib
import os
import select
import stat
import sys
from collections import deque
from typing import TextIO

_MOST = 1000
"""Lines that wait; the oldest go first where there are more."""
_PART = 512
"""Characters that are handed over at once: as much as whoever is ready takes without waiting."""


class Lines:
    """Standard output and, if ``live``, one line on standard error that is written over."""

    def __init__(self, *, live: bool = False) -> None:
        self._live = live
        self._waiting: deque[str] = deque(maxlen=_MOST)

    def say(self, line: str) -> None:
        """A line on standard output, after those that wait."""
        self._waiting.extend(line.split("\n"))
        self.flush()

    def show(self, line: str) -> None:
        """The live line, unless the terminal takes nothing now; what waits comes before it."""
        self.flush()
        if self._live and _takes(sys.stderr):
            _write(sys.stderr, f"\r\x1b[2K{line}"[:_PART])

    def flush(self) -> None:
        """What the reader takes now of what waits."""
        while self._waiting and _takes(sys.stdout):
            line = self._waiting[0]
            rest = line[_PART:]
            _write(sys.stdout, line[:_PART] + ("" if rest else "\n"))
            if rest:
                self._waiting[0] = rest
            else:
                self._waiting.popleft()

    def end(self) -> None:
        """All that waits, however long it takes: for when nothing depends on the loop any more."""
        if self._live:
            _write(sys.stderr, "\n")
        for line in self._waiting:
            _write(sys.stdout, line + "\n")
        self._waiting.clear()


def _takes(stream: TextIO) -> bool:
    """Whether a short text is taken at once. What has no descriptor, and a file, take all."""
    try:
        descriptor = stream.fileno()
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            return True
        return bool(select.select([], [descriptor], [], 0)[1])
    except (OSError, ValueError):
        return True


def _write(stream: TextIO, text: str) -> None:
    with contextlib.suppress(OSError, ValueError):
        stream.write(text)
        stream.flush()
