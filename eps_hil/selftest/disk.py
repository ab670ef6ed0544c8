"""The disk that a recorder writes to: speed with fsync, the longest wait, and how long it lasts."""

import os
import shutil
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from eps_hil.selftest.check import Check, Verdict, graded, graded_least

BYTES_PER_FRAME = 55
"""A line of candump text with 8 bytes."""
_CHUNK = 1 << 20
_GOOD_TIMES, _LIMITED_TIMES = 10.0, 2.0
_GOOD_WAIT_S, _LIMITED_WAIT_S = 0.5, 2.0
_GOOD_HOURS, _LIMITED_HOURS = 24.0, 1.0


@dataclass(frozen=True, slots=True)
class Disk:
    """``mb_s`` with an fsync after each MiB; ``wait_s`` the longest of these; free bytes."""

    folder: Path
    mb_s: float
    wait_s: float
    free_bytes: int


def measure(folder: Path, mib: int) -> Disk:
    """Write ``mib`` MiB to a file in ``folder`` that is removed again; OSError if refused."""
    chunk, longest = os.urandom(_CHUNK), 0.0
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".eps-hil-selftest-") as file:
        began = time.perf_counter()
        for _ in range(mib):
            file.write(chunk)
            file.flush()
            before = time.perf_counter()
            os.fsync(file.fileno())
            longest = max(longest, time.perf_counter() - before)
        spent = time.perf_counter() - began
    return Disk(
        folder.resolve(), mib * _CHUNK / 1e6 / spent, longest, shutil.disk_usage(folder).free
    )


def refused(folder: Path, error: OSError) -> Check:
    """A folder that no recording can be written to."""
    return Check(
        "disk_speed", f"writing to {folder.resolve()}", error.strerror or str(error), "possible",
        Verdict.NOT_GOOD, "a recorder has to write somewhere", "name a folder with --folder",
    )  # fmt: skip


def judge(found: Disk, frames_per_s: float) -> list[Check]:
    """Ten times what a recorder needs, for it shares the disk; a night and a day of room."""
    need_mb_s = frames_per_s * BYTES_PER_FRAME / 1e6
    times = found.mb_s / need_mb_s
    hours = found.free_bytes / (need_mb_s * 1e6) / 3600
    speed = graded_least(times, _GOOD_TIMES, _LIMITED_TIMES)
    wait = graded(found.wait_s, _GOOD_WAIT_S, _LIMITED_WAIT_S)
    room = graded_least(hours, _GOOD_HOURS, _LIMITED_HOURS)
    other = "record to another disk (a local SSD, no network share)"
    return [
        Check(
            "disk_speed", f"writing to {found.folder}",
            f"{found.mb_s:.0f} MB/s; {frames_per_s:.0f} frames/s need {need_mb_s:.2f} MB/s",
            f"{_GOOD_TIMES:.0f} times", speed, "other programs write too",
            "" if speed is Verdict.GOOD else other, found.mb_s, "MB/s",
        ),
        Check(
            "disk_wait", "longest fsync", f"{found.wait_s * 1e3:.0f} ms",
            f"{_GOOD_WAIT_S * 1e3:.0f} ms", wait,
            "the recorder makes its file whole every half second; meanwhile frames wait in "
            "the receive buffer", "" if wait is Verdict.GOOD else other, found.wait_s, "s",
        ),
        Check(
            "disk_room", "room for recording", f"{found.free_bytes / 1e9:.0f} GB, {hours:.0f} h",
            f"{_GOOD_HOURS:.0f} h", room, "a night and a day without anybody",
            "" if room is Verdict.GOOD else "make room, or record to another disk", hours, "h",
        ),
    ]  # fmt: skip
