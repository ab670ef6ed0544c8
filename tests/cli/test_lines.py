"""What is said from within a loop (cli/_lines.py): a reader that stops reading holds nothing up."""

import contextlib
import os
import sys
import threading
import time

import pytest

from eps_hil.cli._lines import Lines

LINES = [f"line {k} {'.' * (k % 700)}" for k in range(400)]


def piped(monkeypatch: pytest.MonkeyPatch) -> int:
    """Standard output and error are one pipe from here on; its other end."""
    reader, writer = os.pipe()
    out = os.fdopen(writer, "w")
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", out)
    return reader


def test_a_full_pipe_holds_nothing_up_and_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = piped(monkeypatch)
    lines, began = Lines(), time.monotonic()
    for line in LINES:  # 140 kB, of which a pipe takes 64
        lines.say(line)
    assert time.monotonic() - began < 2.0
    read: list[bytes] = []

    def reads() -> None:
        while not b"".join(read).endswith(b"the end\n"):
            read.append(os.read(pipe, 65536))

    reader = threading.Thread(target=reads, daemon=True)
    reader.start()
    lines.say("the end")
    lines.end()
    reader.join(10.0)
    assert b"".join(read).decode().splitlines() == [*LINES, "the end"]


def test_the_live_line_is_left_out_where_nobody_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = piped(monkeypatch)
    lines = Lines(live=True)
    for _ in range(2000):
        lines.show("x" * 100)
    os.set_blocking(pipe, False)
    there = b""
    with contextlib.suppress(BlockingIOError):
        while True:
            there += os.read(pipe, 65536)
    assert 0 < there.count(b"\r") < 1000


def test_a_reader_that_went_away_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = piped(monkeypatch)
    os.close(pipe)
    lines = Lines(live=True)
    lines.say("nobody reads this")
    lines.show("nor this")
    lines.end()


def test_more_than_can_wait_loses_the_oldest(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = piped(monkeypatch)
    lines = Lines()
    for k in range(20_000):
        lines.say(f"{k:050d}")
    read: list[bytes] = []

    def reads() -> None:
        while not b"".join(read[-2:]).endswith(b"19999\n"):
            read.append(os.read(pipe, 65536))

    reader = threading.Thread(target=reads, daemon=True)
    reader.start()
    lines.end()
    reader.join(10.0)
    assert not reader.is_alive()
    assert b"".join(read).count(b"\n") < 4000
