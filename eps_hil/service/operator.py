"""Who holds the dead-man: a person at a terminal, or nobody, said out loud.

A person arms with two different keys and then keeps the space bar down; the terminal's repeats are
the heartbeat, so a hand that lets go, a terminal that hangs, or a lost ssh connection ends the
torque. A key that only has to be pressed once would not notice any of these; a question answered
by the program itself is no dead-man at all, which is why leaving it out has a long name.
"""

import asyncio
import contextlib
import os
import sys
import termios
import tty
from collections.abc import Callable
from typing import Protocol

from eps_hil.errors import InputError

HINT = "keys: a, then y within the arming window, then hold the space bar; q ends"
_PERIOD_S = 0.02


class Desk(Protocol):
    """What an operator can do to a session."""

    def prepare(self) -> bool:
        """First step of arming."""

    def arm(self) -> bool:
        """Second step of arming."""

    def heartbeat(self) -> None:
        """A sign of life."""

    def finish(self, why: str) -> None:
        """End the session."""


class Operator(Protocol):
    """Started with the session, stopped with it."""

    def start(self, loop: asyncio.AbstractEventLoop, desk: Desk) -> None:
        """Begin to act on the desk."""

    def stop(self) -> None:
        """Give the terminal back."""


class KeyOperator:
    """Keys of a terminal (or bytes of a pipe): ``a`` and ``y`` arm, the space bar is held."""

    def __init__(self, descriptor: int | None = None) -> None:
        self._fd = sys.stdin.fileno() if descriptor is None else descriptor
        self._loop: asyncio.AbstractEventLoop | None = None
        self._before: list[int | list[bytes | int]] | None = None

    def start(self, loop: asyncio.AbstractEventLoop, desk: Desk) -> None:
        """Take keys one by one, without waiting for Enter."""
        self._loop = loop
        if os.isatty(self._fd):
            self._before = termios.tcgetattr(self._fd)
            tty.setcbreak(self._fd)  # Ctrl-C stays a signal
        actions: dict[int, Callable[[], object]] = {
            ord("a"): desk.prepare,
            ord("y"): desk.arm,
            ord(" "): desk.heartbeat,
            ord("q"): lambda: desk.finish("ended by the operator"),
        }

        def on_keys() -> None:
            keys = b""
            with contextlib.suppress(OSError):  # hung up
                keys = os.read(self._fd, 256)
            if not keys:
                loop.remove_reader(self._fd)
                desk.finish("the operator's terminal is gone")
            for key in keys:
                actions.get(key, lambda: None)()

        loop.add_reader(self._fd, on_keys)

    def stop(self) -> None:
        """No more keys; the terminal as it was."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.remove_reader(self._fd)
        if self._before is not None:
            # not after what is still to be shown: a terminal that hangs shows nothing any more
            with contextlib.suppress(termios.error):  # nor is one that is gone set any more
                termios.tcsetattr(self._fd, termios.TCSANOW, self._before)
            self._before = None


def _raise(task: "asyncio.Task[None]") -> None:
    """To the loop's handler, which a task that nobody awaits does not reach."""
    if not task.cancelled() and (error := task.exception()) is not None:
        raise error


class Unattended:
    """Nobody holds anything: arms by itself as soon as it may, and beats while the loop runs."""

    def __init__(self) -> None:
        self._task: asyncio.Task[None] | None = None

    def start(self, loop: asyncio.AbstractEventLoop, desk: Desk) -> None:
        """Arm once, and beat; an error (a full disk, say) ends the session."""
        self._task = loop.create_task(self._act(desk))
        self._task.add_done_callback(_raise)

    async def _act(self, desk: Desk) -> None:
        pause_s = 0.25
        while True:
            if desk.prepare():
                await asyncio.sleep(pause_s)
                if desk.arm():
                    break
            await asyncio.sleep(pause_s)
        while True:
            desk.heartbeat()
            await asyncio.sleep(_PERIOD_S)

    def stop(self) -> None:
        """No more heartbeats."""
        if self._task is not None:
            self._task.cancel()


def terminal_operator() -> KeyOperator:
    """The terminal this runs in; :class:`InputError` where there is none."""
    if not sys.stdin.isatty():
        raise InputError(
            "stdin", "", "is no terminal, so nobody can hold the dead-man key",
            "run it in one, or say --yes-i-stand-clear (nobody is near the steering wheel)",
        )  # fmt: skip
    return KeyOperator()
