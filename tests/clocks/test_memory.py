"""Logs of a night: what is held of each frame is small, and a copy holds none but what waits."""

import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.clocks.audit import audit
from eps_hil.clocks.corrected import write_corrected
from eps_hil.clocks.payloads import Payloads
from eps_hil.clocks.stamps import read_channels

FRAMES = 60_000


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Two buses, 2 ms apart."""
    path = tmp_path / "night.log"
    with path.open("w") as file:
        for k in range(FRAMES // 2):
            at_s = 1_700_000_000 + k * 1e-3
            file.write(
                f"({at_s:.6f}) can0 {0x100 + k % 3:03X}#{k % 256:02X}0203040506{k % 4096:04X}\n"
            )
            file.write(f"({at_s + 2e-3:.6f}) can1 200#{k:08X}\n")
    return path


def peak_of(what: Callable[[], Any]) -> tuple[Any, float]:
    """What it gives, and how many bytes a frame it held at most."""
    tracemalloc.start()
    try:
        found = what()
        return found, tracemalloc.get_traced_memory()[1] / FRAMES
    finally:
        tracemalloc.stop()


def test_frames_are_held_as_arrays(log: Path) -> None:
    channels, held = peak_of(lambda: read_channels(log))
    assert held < 100
    assert [one.name for one in channels] == ["can0", "can1"]
    assert [len(one.t_ns) for one in channels] == [FRAMES // 2] * 2
    (message,) = channels[1].messages
    rows = message.data.rows()
    assert rows is not None
    assert rows[1234].tobytes() == (1234).to_bytes(4, "big")


@pytest.mark.parametrize("suffix", ["log", "blf"])
def test_a_copy_is_written_as_the_log_is_read(log: Path, tmp_path: Path, suffix: str) -> None:
    found = audit(log)
    target = tmp_path / f"copy.{suffix}"
    write_corrected(found, target)  # what this loads is not of the log
    count, held = peak_of(lambda: write_corrected(found, target))
    assert count == FRAMES
    assert held < 100


def test_payloads_of_any_length() -> None:
    some = [b"", b"a", b"bc", b"a"]
    hashes = Payloads.of(some).hashes()
    assert hashes[1] == hashes[3]
    assert len(set(hashes.tolist())) == 3
    assert Payloads.of(some).rows() is None
    assert Payloads.of([]).rows() is None
    np.testing.assert_array_equal(Payloads.of([b"ab", b"cd"]).rows(), [[97, 98], [99, 100]])
