"""The first answer after installation: interpreted at once, while it is compiled for the next.

Where it has to be compiled first, nobody waits without a word.
"""

import contextlib
import functools
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from eps_hil.series import Series

MOST_SAMPLES = 400_000
"""Interpreted, these take some twenty seconds; more of them wait for the compiler."""
LATE_S = 2.0
"""A process that compiles for longer says so."""


def _is_compiled(effects: bool) -> bool:
    """Whether machine code of the batch run is on disk, for models with or without effects."""
    from eps_hil import compiled

    if compiled.FOLDER is None:
        return False
    table = b"Added" if effects else b"Nothing"  # the type by which it was compiled
    # in which folder depends on numba's version
    found = compiled.FOLDER.rglob("lanes.run-*.nbi")
    return any(table in index.read_bytes() for index in found)


def prepare(series: "Mapping[str, Series]", recordings: int, *, effects: bool) -> None:
    """Before the estimator is imported: let it run as Python if none of it is compiled yet.

    Short recordings then wait for nothing; ``recordings`` are taken to be as long as this one.
    Both give the same bits. ``effects``: whether the model has any.
    """
    from eps_hil import compiled

    if _is_compiled(effects):
        return
    samples = recordings * sum(len(one.t_ns) for one in series.values())
    if samples > MOST_SAMPLES or not compiled.interpret():
        return
    if compiled.FOLDER is None:
        return
    with contextlib.suppress(OSError):
        subprocess.Popen(
            [sys.executable, "-m", "eps_hil.estimation.ahead"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            start_new_session=True,
        )  # fmt: skip
        _say("estimated without compiled code, which is made in the background, once")


@functools.cache
def say_if_it_compiles() -> None:
    """From here on: one line on stderr, once, if kernels are compiled and it takes its time.

    Another one if it waits for code that another process compiles. For logs and pipes; at a
    terminal :mod:`eps_hil.compiled` says it at once. What is found on disk is not compiled, and
    costs nothing. Imports numba: for verbs that are about to compute.
    """
    from numba.core import event

    from eps_hil import compiled

    compiled.tell_logs_too()

    class Compiling(event.Listener):
        """Sums the outermost compilations' time: numba holds one lock over all threads."""

        depth, spent_s, begun_s = 0, 0.0, 0.0
        timer: threading.Timer | None = None
        said = threading.Lock()  # for good, by whoever says it first

        def say(self) -> None:
            if self.said.acquire(blocking=False):
                _complain(compiled.COMPILING)

        def on_start(self, event: object) -> None:
            self.depth += 1
            if self.depth > 1 or self.said.locked():
                return
            if sys.stderr.isatty():
                self.said.acquire(blocking=False)  # elsewhere, by now
                return
            self.begun_s = time.monotonic()
            self.timer = threading.Timer(LATE_S - self.spent_s, self.say)
            self.timer.daemon = True
            self.timer.start()

        def on_end(self, event: object) -> None:
            self.depth -= 1
            if self.depth == 0 and self.timer is not None:
                self.timer.cancel()
                self.timer = None
                self.spent_s += time.monotonic() - self.begun_s
                if self.spent_s >= LATE_S:  # the timer was about to say it
                    self.say()

    listen: Any = event.register  # carries no types
    listen("numba:compile", Compiling())


def say_if_others_compile(module: str) -> None:
    """One line on stderr if no kernel of ``module`` is on disk: other processes will compile.

    Nobody reads their stderr, or there are many of them.
    """
    from eps_hil import compiled

    if compiled.FOLDER is None or not any(compiled.FOLDER.rglob(f"{module}.*.nbi")):
        _complain(compiled.COMPILING)


def _complain(line: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # nobody listens
        typer.echo(line, err=True)


def _say(text: str) -> None:
    if sys.stderr.isatty():
        typer.echo(text, err=True)
