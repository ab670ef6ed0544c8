"""Pause and single step of a replay: keys of a terminal, signals where there is none.

Space pauses and goes on, ``n`` or ``s`` sends the next frame and stays paused, ``q`` ends. Without
a terminal SIGUSR1 pauses and goes on, SIGUSR2 sends the next frame.
"""

import contextlib
import os
import select
import signal
import sys
import termios
import tty
from collections.abc import Iterator
from types import FrameType

HINT = "keys: space pauses, n sends the next frame, q ends"


class ReplayControls:
    """What the person (or program) beside a replay has asked for."""

    def __init__(self) -> None:
        self.paused = False
        self.quit = False
        self._steps = 0
        self._fd: int | None = None

    def toggle(self) -> None:
        """Pause, or go on."""
        self.paused, self._steps = not self.paused, 0

    def step(self) -> None:
        """Pause, and let one frame through."""
        self.paused = True
        self._steps += 1

    def take_step(self) -> bool:
        """Whether one frame may pass while paused; used up by asking."""
        if self._steps:
            self._steps -= 1
            return True
        return False

    def look(self) -> None:
        """Take the keys that were pressed since the last look; never waits."""
        if self._fd is None or not select.select([self._fd], [], [], 0.0)[0]:
            return
        keys = os.read(self._fd, 64)
        if not keys:  # the terminal is gone; signals are left
            self._fd = None
        for key in keys.decode("ascii", "ignore").lower():
            if key == " ":
                self.toggle()
            elif key in "ns":
                self.step()
            elif key == "q":
                self.quit = True

    def hear_signals(self) -> None:
        """Take SIGUSR1 and SIGUSR2 from now on: one that nobody takes ends the process."""
        signal.signal(signal.SIGUSR1, self._on_toggle)
        signal.signal(signal.SIGUSR2, self._on_step)

    @contextlib.contextmanager
    def open(self) -> Iterator[bool]:
        """Listen to keys (yields True) and signals; the terminal is given back at the end."""
        self.hear_signals()
        # A background job that touches its terminal is stopped by it
        if not sys.stdin.isatty() or os.tcgetpgrp(sys.stdin.fileno()) != os.getpgrp():
            yield False
            return
        self._fd = sys.stdin.fileno()
        before = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd)  # Ctrl-C stays a signal
        try:
            yield True
        finally:
            termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, before)

    def _on_toggle(self, number: int, frame: FrameType | None) -> None:
        self.toggle()

    def _on_step(self, number: int, frame: FrameType | None) -> None:
        self.step()
