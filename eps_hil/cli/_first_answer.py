"""The first answer after installation: interpreted at once, while it is compiled for the next."""

import contextlib
import subprocess
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from eps_hil.series import Series

MOST_SAMPLES = 400_000
"""Interpreted, these take some twenty seconds; more of them wait for the compiler."""


def _is_compiled(effects: bool) -> bool:
    """Whether machine code of the batch run is on disk, for models with or without effects."""
    from eps_hil import compiled

    if compiled.FOLDER is None:
        return False
    place = compiled.FOLDER / "functions" / "estimation" / "stream_steps"
    table = b"Added" if effects else b"Nothing"  # the type by which it was compiled
    return any(table in index.read_bytes() for index in place.glob("*.run-*.nbi"))


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


def _say(text: str) -> None:
    if sys.stderr.isatty():
        typer.echo(text, err=True)
