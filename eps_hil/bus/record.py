"""Record a CAN bus to candump ``.log`` or Vector ``.blf``, so that a crash loses next to nothing.

The writers are python-can's; what is added is that the file is whole at least every half second:
flushed, and for BLF with its header brought up to date (python-can writes the start time only at
the end, and a killed recorder would leave stamps without a date). When the disk is full the file
is cut back to the last whole state and stays readable.
"""

import contextlib
import io
import os
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port
from eps_hil.errors import BusError, EpsHilError, InputError

FLUSH_S = 0.5
_WAIT_S = 0.2
_REST_S = 0.5  # a bus that never pauses is left after that long


class RecordError(EpsHilError):
    """The recording had to end (disk full, bus lost); what was written is readable."""


@dataclass(frozen=True, slots=True)
class RecordReport:
    """``frames`` written (with ``error_frames``) in ``duration_s``; ``lost`` in the kernel."""

    frames: int
    lost: int
    error_frames: int
    duration_s: float
    file_bytes: int


class LogFile(Protocol):
    """A log that is being written."""

    def write(self, frames: list[Frame]) -> None:
        """Append frames; OSError when the disk refuses."""

    def flush(self) -> None:
        """Make what was written readable from the file as it is now."""

    def cut_back(self) -> None:
        """Close with what the last :meth:`flush` left, writing nothing more."""

    def close(self) -> None:
        """Complete the file."""


def check_target(path: str | Path, *, overwrite: bool = False) -> None:
    """:class:`InputError` unless ``path`` may become a recording; touches nothing."""
    file = Path(path)
    if file.suffix.lower() not in _KINDS:
        remedy = "name the file .log (candump) or .blf; export MF4 with eps-hil convert"
        raise InputError(path, "", f"'{file.suffix}' is not recorded", remedy)
    if file.exists() and not overwrite and (not file.is_file() or file.stat().st_size):
        raise InputError(path, "", "exists already", "choose another name, or add --overwrite")
    if not file.parent.is_dir():
        raise InputError(path, "", f"no such folder: {file.parent}", "make it, or choose another")


def open_log(path: str | Path, channel: str, *, overwrite: bool = False) -> LogFile:
    """A new log by suffix (``.log``, ``.blf``); :class:`InputError` if it cannot be made."""
    check_target(path, overwrite=overwrite)
    try:
        file = io.BufferedRandom(io.FileIO(path, "w+"), buffer_size=1 << 16)
        return _KINDS[Path(path).suffix.lower()](file, channel)
    except OSError as error:
        raise InputError(path, "", f"cannot be written: {error.strerror}") from None


class _Kept:
    """A binary file that can be cut back to its last whole state."""

    def __init__(self, file: io.BufferedRandom) -> None:
        self.file = file
        self._whole_bytes = 0

    def mark_whole(self) -> None:
        self.file.flush()
        self._whole_bytes = os.fstat(self.file.fileno()).st_size

    def cut_back(self) -> None:
        """Drop what came after the last whole state, buffered bytes included."""
        descriptor = self.file.fileno()
        os.ftruncate(descriptor, self._whole_bytes)
        # Closing flushes; what is still buffered must not reach the file that was just mended.
        nowhere = os.open(os.devnull, os.O_RDWR)
        os.dup2(nowhere, descriptor)
        os.close(nowhere)
        with contextlib.suppress(OSError):
            self.file.close()


class CandumpFile:
    """``candump -L`` text: one line a frame, stamps in whole microseconds.

    Error frames keep no detail in this format as python-can writes it; BLF keeps it.
    """

    def __init__(self, file: io.BufferedRandom, channel: str) -> None:
        from can import CanutilsLogWriter

        self._kept = _Kept(file)
        self._lines = io.StringIO()
        # The format separates by spaces and knows network interfaces, not addresses
        name = channel if re.fullmatch(r"[A-Za-z][\w.-]*", channel) else "can0"
        self._writer = CanutilsLogWriter(self._lines, channel=name)

    def write(self, frames: list[Frame]) -> None:
        """Append frames."""
        from eps_hil.bus.python_can import to_message

        for frame in frames:
            self._writer.on_message_received(to_message(frame))
        self._kept.file.write(self._lines.getvalue().encode("ascii"))
        self._lines.seek(0)
        self._lines.truncate()

    def flush(self) -> None:
        """Every line so far is in the file."""
        self._kept.mark_whole()

    def cut_back(self) -> None:
        """Keep what the last :meth:`flush` left."""
        self._kept.cut_back()

    def close(self) -> None:
        """Close the file."""
        self._kept.mark_whole()
        self._kept.file.close()


class BlfFile:
    """Vector BLF. Needs python-can's private ``_flush`` and ``_write_header`` to be whole early."""

    def __init__(self, file: io.BufferedRandom, channel: str) -> None:
        from can import BLFWriter

        self._kept = _Kept(file)
        self._writer = BLFWriter(file)
        self.flush()

    def write(self, frames: list[Frame]) -> None:
        """Append frames."""
        from eps_hil.bus.python_can import to_message

        for frame in frames:
            self._writer.on_message_received(to_message(frame))

    def flush(self) -> None:
        """Every frame so far is in a closed container, and the header dates them."""
        file, writer = self._kept.file, self._writer
        while writer._buffer_size:
            writer._flush()
        file.flush()
        size = file.tell()
        file.seek(0)
        writer._write_header(size)
        file.seek(size)
        self._kept.mark_whole()

    def cut_back(self) -> None:
        """Keep what the last :meth:`flush` left."""
        self._kept.cut_back()

    def close(self) -> None:
        """Complete the header and close the file."""
        self.flush()
        self._kept.file.close()


_KINDS: dict[str, Callable[[io.BufferedRandom, str], LogFile]] = {
    ".log": CandumpFile,
    ".blf": BlfFile,
}


def record(
    port: Port,
    log: LogFile,
    path: str | Path,
    *,
    duration_s: float | None = None,
    stop: Callable[[], bool] = lambda: False,
    progress: Callable[[int], None] | None = None,
) -> RecordReport:
    """Write everything ``port`` receives until ``stop()``, ``duration_s`` or the end of the bus.

    What waits in the port by then is written too. Closes ``log`` in every case.
    :class:`RecordError` when the disk is full or the bus is gone; the file then holds what the
    message says.
    """
    started_s = flushed_s = time.monotonic()
    written = kept = 0
    gone = ""
    try:
        while not gone and not stop():
            now_s = time.monotonic()
            if duration_s is not None and now_s - started_s >= duration_s:
                break
            try:
                frames = port.recv(_WAIT_S)
            except BusError as error:
                gone, frames = str(error), []
            log.write(frames)
            written += len(frames)
            if now_s - flushed_s >= FLUSH_S:
                log.flush()
                flushed_s, kept = now_s, written
                if progress is not None:
                    progress(written)
        if not gone:
            written += _write_rest(port, log)
        log.close()
    except OSError as error:
        log.cut_back()
        raise RecordError(
            f"{path}: cannot write on: {error.strerror}; the file holds the first {kept} frames "
            f"and is readable, {written - kept} more are lost; make room and start again"
        ) from None
    counts = port.counts
    if gone:
        raise RecordError(f"{gone}; {path} holds the {written} frames before that")
    return RecordReport(
        frames=written,
        lost=counts.lost_in_kernel,
        error_frames=counts.error_frames,
        duration_s=time.monotonic() - started_s,
        file_bytes=Path(path).stat().st_size,
    )


def _write_rest(port: Port, log: LogFile) -> int:
    """Write what came before the stop and is not read yet; how many frames it was.

    A machine that was busy elsewhere may not have read for a while when it is told to stop.
    """
    until_s = time.monotonic() + _REST_S
    written = 0
    with contextlib.suppress(BusError):  # gone while it was left anyway
        while frames := port.recv(0.0):
            log.write(frames)
            written += len(frames)
            if time.monotonic() >= until_s:
                break
    return written
