"""Several rigs under one command: a process for each, watched, and started anew when it dies.

Processes rather than one loop, because a loop that serves two rigs serves both late when one of
them floods it, and an error in one would end both. To its rigs a fleet is what systemd is to a
single service: it listens to their signs of life, and kills one whose loop hangs.
"""

import contextlib
import ctypes
import os
import selectors
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_LOOK_S = 0.1
_PAUSE_S, _PAUSE_MOST_S = 1.0, 30.0
_LONG_S = 60.0
"""Who ran so long before it died is started anew without a longer pause."""
_END_S = 10.0
_WRONG_INPUT = 2
_PR_SET_PDEATHSIG = 1

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Rig:
    """``name`` stands before each of its lines; ``words``: the command line of its service.

    ``numbered``: a file among the words that a start anew must not write over.
    """

    name: str
    words: tuple[str, ...]
    numbered: Path | None = None

    def words_of(self, start: int) -> tuple[str, ...]:
        """The command line of the first start (1), and of those that follow: ``e_0002.csv``."""
        path = self.numbered
        if path is None or start == 1:
            return self.words
        own = str(path.with_name(f"{path.stem}_{start:04d}{path.suffix}"))
        return tuple(own if word == str(path) else word for word in self.words)


class _Process:
    """One rig's service: the process of the moment, and what became of those before."""

    def __init__(self, rig: Rig, folder: Path, number: int, watchdog_s: float, say: Say) -> None:
        self.rig, self._say, self._watchdog_s = rig, say, watchdog_s
        self._address = str(folder / f"rig{number}")
        self.ear = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.ear.setblocking(False)
        self.ear.bind(self._address)
        self.process: subprocess.Popen[bytes] | None = None
        self.status: int | None = None
        self.starts = 0
        self.ready = False
        self._pause_s, self._next_s, self._began_s, self._fed_s = _PAUSE_S, 0.0, 0.0, 0.0
        self._rest = b""

    @property
    def over(self) -> bool:
        """Whether it has ended for good."""
        return self.status is not None

    def start(self, selector: selectors.BaseSelector) -> None:
        environment = os.environ | {
            "NOTIFY_SOCKET": self._address,
            "WATCHDOG_USEC": str(round(self._watchdog_s * 1e6)),
            "PYTHONUNBUFFERED": "1",
        }
        environment.pop("WATCHDOG_PID", None)
        self.starts += 1
        self.process = subprocess.Popen(
            self.rig.words_of(self.starts), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, env=environment, start_new_session=True,
            preexec_fn=_end_with_parent,  # noqa: PLW1509  there is one thread
        )  # fmt: skip
        assert self.process.stdout is not None
        os.set_blocking(self.process.stdout.fileno(), False)
        selector.register(self.process.stdout, selectors.EVENT_READ, self)
        self.ready, self._rest, self._began_s = False, b"", time.monotonic()

    def read(self) -> None:
        """Its lines, with its name in front."""
        assert self.process is not None
        assert self.process.stdout is not None
        with contextlib.suppress(BlockingIOError):
            while chunk := os.read(self.process.stdout.fileno(), 65_536):
                *lines, self._rest = (self._rest + chunk).split(b"\n")
                for line in lines:
                    self.say(line.decode(errors="replace"))

    def hear(self) -> None:
        """Its signs of life."""
        with contextlib.suppress(BlockingIOError):
            while True:
                said = self.ear.recv(4096)
                self._fed_s = time.monotonic()
                self.ready |= b"READY=1" in said

    def look_after(self, selector: selectors.BaseSelector, *, ending: bool) -> None:
        """Start it, see that it lives, and what became of it."""
        now_s = time.monotonic()
        if self.process is None:
            if not self.over and not ending and now_s >= self._next_s:
                self.start(selector)
            return
        status = self.process.poll()
        if status is None:
            if self.ready and now_s - self._fed_s > self._watchdog_s:
                self.say(f"no sign of life for {self._watchdog_s:g} s; killed")
                self.ready = False
                self.process.kill()
            return
        self.read()
        assert self.process.stdout is not None
        selector.unregister(self.process.stdout)
        self.process.stdout.close()
        self.process = None
        self._ended(status, now_s, ending=ending)

    def say(self, line: str) -> None:
        """One line of this rig's."""
        self._say(f"[{self.rig.name}] {line}")

    def _ended(self, status: int, now_s: float, *, ending: bool) -> None:
        if ending and status == -signal.SIGTERM:  # it had not begun to heed it: asked for, too
            status = 0
        if ending or status in {0, _WRONG_INPUT}:
            self.status = status
            if status:
                self.say(f"ended with status {status}")
            return
        if now_s - self._began_s > _LONG_S:
            self._pause_s = _PAUSE_S
        self.say(f"ended with status {status}; started anew in {self._pause_s:g} s")
        self._next_s = now_s + self._pause_s
        self._pause_s = min(2 * self._pause_s, _PAUSE_MOST_S)


class Fleet:
    """The services of several rigs; ``watchdog_s``: silence after which one is killed."""

    def __init__(self, rigs: Sequence[Rig], say: Say, *, watchdog_s: float = 5.0) -> None:
        self._rigs, self._say, self._watchdog_s = rigs, say, watchdog_s
        self.starts: dict[str, int] = {}
        """How often each was started."""

    def run(
        self, stop: Callable[[], bool], on_ready: Callable[[], None] = lambda: None,
        on_look: Callable[[], None] = lambda: None,
    ) -> int:  # fmt: skip
        """Until all have ended, or ``stop()``; the largest status of those that ended.

        ``on_ready``: called once when all are ready; ``on_look``: ten times a second.
        """
        with tempfile.TemporaryDirectory(prefix="eps-hil-") as folder:
            made = [
                _Process(rig, Path(folder), number, self._watchdog_s, self._say)
                for number, rig in enumerate(self._rigs)
            ]
            with selectors.DefaultSelector() as selector:
                for each in made:
                    selector.register(each.ear, selectors.EVENT_READ, each)
                try:
                    self._serve(made, selector, stop, on_ready, on_look)
                finally:
                    self._end(made, selector)
                    self.starts = {each.rig.name: each.starts for each in made}
        statuses = [each.status or 0 for each in made]
        return max((abs(status) for status in statuses), default=0)

    def _serve(
        self, made: list[_Process], selector: selectors.BaseSelector, stop: Callable[[], bool],
        on_ready: Callable[[], None], on_look: Callable[[], None],
    ) -> None:  # fmt: skip
        told = False
        while not stop() and not all(each.over for each in made):
            for each in made:
                each.look_after(selector, ending=False)
            _listen(selector)
            on_look()
            if not told and all(each.ready for each in made):
                told = True
                on_ready()

    def _end(self, made: list[_Process], selector: selectors.BaseSelector) -> None:
        """SIGTERM, and SIGKILL for who takes too long."""
        until_s = time.monotonic() + _END_S
        for each in made:
            if each.process is not None:
                each.process.send_signal(signal.SIGTERM)
        while any(each.process is not None for each in made):
            for each in made:
                if time.monotonic() > until_s and each.process is not None:
                    each.process.kill()
                each.look_after(selector, ending=True)
            _listen(selector)
        for each in made:
            each.ear.close()


def _listen(selector: selectors.BaseSelector) -> None:
    for key, _ in selector.select(_LOOK_S):
        each: Any = key.data
        each.hear() if key.fileobj is each.ear else each.read()


def _end_with_parent() -> None:
    """In the child: a fleet that is killed leaves no service behind."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
