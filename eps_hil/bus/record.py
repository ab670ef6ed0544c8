"""Log files that are being written, candump ``.log`` or Vector ``.blf``: whole at every moment.

BLF is written by python-can; what is added is that a file is whole whenever :meth:`LogFile.flush`
was called: for BLF with its header brought up to date (python-can writes the start time only at
the end, and a killed recorder would leave stamps without a date). When the disk is full the file
is cut back to the last whole state and stays readable. ``bus/recorder.py`` records with them.
"""

import contextlib
import io
import itertools
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from eps_hil.bus.candump_line import candump_line
from eps_hil.bus.frame import Frame
from eps_hil.errors import InputError

FORMATS = (".log", ".blf")
_NAME = re.compile(r"[A-Za-z][\w.-]*", re.ASCII)


class LogFile(Protocol):
    """A log that is being written."""

    def write(self, frames: Sequence[Frame], channel: int = 0) -> None:
        """Append frames of the channel with this index; OSError when the disk refuses."""

    def flush(self) -> None:
        """Make what was written readable from the file as it is now."""

    def sync(self) -> None:
        """As :meth:`flush`, and on the disk: what is left after a power cut."""

    @property
    def size_bytes(self) -> int:
        """Of the file after the last :meth:`flush`."""

    def cut_back(self) -> None:
        """Close with what the last :meth:`flush` left, writing nothing more."""

    def close(self) -> None:
        """Complete the file, and on the disk."""


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


def open_log(
    path: str | Path, channels: str | Sequence[str], *, overwrite: bool = False
) -> LogFile:
    """A new log by suffix (``.log``, ``.blf``) of one or several channels, in their order.

    :class:`InputError` if it cannot be made.
    """
    names = [channels] if isinstance(channels, str) else list(channels)
    check_target(path, overwrite=overwrite)
    try:
        file = io.BufferedRandom(io.FileIO(path, "w+"), buffer_size=1 << 16)
        return _KINDS[Path(path).suffix.lower()](file, names)
    except OSError as error:
        raise InputError(path, "", f"cannot be written: {error.strerror}") from None


def channel_names(channels: Sequence[str]) -> list[str]:
    """What a candump log calls its channels, each by a name of its own.

    It separates by spaces and knows network interfaces, not addresses: these (and a name that is
    there already, of another interface) are ``can0``, ``can1``, … by their place, or the next free.
    """
    names = [
        each if _NAME.fullmatch(each) and each not in channels[:place] else ""
        for place, each in enumerate(channels)
    ]
    for place, name in enumerate(names):
        if not name:
            numbers = itertools.chain([place], itertools.count())
            names[place] = next(one for k in numbers if (one := f"can{k}") not in names)
    return names


class _Kept:
    """A binary file that can be cut back to its last whole state."""

    def __init__(self, file: io.BufferedRandom) -> None:
        self.file = file
        self.whole_bytes = 0

    def mark_whole(self) -> None:
        self.file.flush()
        self.whole_bytes = os.fstat(self.file.fileno()).st_size

    def sync(self) -> None:
        self.mark_whole()
        os.fsync(self.file.fileno())

    def cut_back(self) -> None:
        """Drop what came after the last whole state, buffered bytes included."""
        descriptor = self.file.fileno()
        os.ftruncate(descriptor, self.whole_bytes)
        # Closing flushes; what is still buffered must not reach the file that was just mended.
        nowhere = os.open(os.devnull, os.O_RDWR)
        os.dup2(nowhere, descriptor)
        os.close(nowhere)
        with contextlib.suppress(OSError):
            self.file.close()


class CandumpFile:
    """``candump -L`` text: one line a frame, stamps in whole microseconds."""

    def __init__(self, file: io.BufferedRandom, channels: Sequence[str]) -> None:
        self._kept = _Kept(file)
        self._channels = channel_names(channels)

    def write(self, frames: Sequence[Frame], channel: int = 0) -> None:
        """Append frames."""
        name = self._channels[channel]
        lines = "".join(candump_line(frame, name) for frame in frames)
        self._kept.file.write(lines.encode("ascii"))

    @property
    def size_bytes(self) -> int:
        """See :class:`LogFile`."""
        return self._kept.whole_bytes

    def flush(self) -> None:
        """Every line so far is in the file."""
        self._kept.mark_whole()

    def sync(self) -> None:
        """And on the disk."""
        self._kept.sync()

    def cut_back(self) -> None:
        """Keep what the last :meth:`flush` left."""
        self._kept.cut_back()

    def close(self) -> None:
        """Close the file."""
        self._kept.sync()
        self._kept.file.close()


class BlfFile:
    """Vector BLF. Needs python-can's private ``_flush`` and ``_write_header`` to be whole early.

    Its channels have numbers: 1 for the first.
    """

    def __init__(self, file: io.BufferedRandom, channels: Sequence[str]) -> None:
        from can import BLFWriter

        self._kept = _Kept(file)
        self._writer = BLFWriter(file)
        self.flush()

    def write(self, frames: Sequence[Frame], channel: int = 0) -> None:
        """Append frames."""
        from eps_hil.bus.python_can import to_message

        for frame in frames:
            self._writer.on_message_received(to_message(frame, channel))

    @property
    def size_bytes(self) -> int:
        """See :class:`LogFile`."""
        return self._kept.whole_bytes

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

    def sync(self) -> None:
        """And on the disk."""
        self.flush()
        self._kept.sync()

    def cut_back(self) -> None:
        """Keep what the last :meth:`flush` left."""
        self._kept.cut_back()

    def close(self) -> None:
        """Complete the header and close the file."""
        self.sync()
        self._kept.file.close()


_KINDS: dict[str, Callable[[io.BufferedRandom, Sequence[str]], LogFile]] = {
    ".log": CandumpFile,
    ".blf": BlfFile,
}
