"""BLF, ASC, TRC and MF4 bus logging, through python-can's readers.

Their stamps are floats of seconds; an epoch float is off by up to 240 ns, so stamps are rounded to
the microsecond (BLF counts from its own start, ASC without a date always does: nothing is lost
there). python-can knows no error base for broken files and logs as it goes; both end here.
"""

import contextlib
import logging
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from eps_hil.bus.asc_lines import AscLines
from eps_hil.bus.frame import Frame
from eps_hil.bus.text_lines import TextLines
from eps_hil.errors import InputError
from eps_hil.recordings.files import needs_extra, refused_by_system
from eps_hil.recordings.mf4_ids import tell_format

_NS = 1_000_000_000
_RELATIVE_S = 1e6  # smaller stamps count from the start and are exact to the nanosecond
_MUCH = 1 << 16
_LOGGERS = ("can", "asammdf")
_BY_LINE = (".asc", ".trc")
_EVENT = re.compile(r"\s*\d+\)?\s+\d")


class _ShortError(ValueError):
    """A line that holds less of a frame than it says."""


class VendorLog:
    """One log; iterating gives (channel, frame) in the order of the file.

    Channels are numbered as the vendor's tools show them, from 1 (MF4: as the file says).
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._kind = path.suffix.lower()
        self._frames = 0
        self._file: Any = None
        self._reader: Any = None
        self._size = max(path.stat().st_size, 1)
        self.notes: list[str] = []

    @property
    def place(self) -> str:
        """Where in the file the last frame stood."""
        line = getattr(self._file, "line", 0)
        return f"line {line}" if line else f"frame {self._frames}"

    @property
    def fraction(self) -> float:
        """How much of the file has been read, 0 to 1 (MF4: not known, 0)."""
        return min(self._position() / self._size, 1.0)

    def __iter__(self) -> Iterator[tuple[str, Frame]]:
        with refused_by_system(self._path), quiet_libraries():
            try:
                yield from self._messages()
            except InputError:
                raise
            except Exception as error:
                if not self._frames or not self._at_end():
                    raise self._broken(error) from None
                self.notes.append(f"the file is damaged or cut off after {self._frames} frames")
            finally:
                if self._file is not None:
                    self._file.close()
                elif self._reader is not None:
                    self._reader.stop()

    def _messages(self) -> Iterator[tuple[str, Frame]]:
        reader, start_ns = self._open()
        self._reader = reader
        first_channel = 1 if self._kind in (".blf", ".asc") else 0
        for message in reader:
            if self._kind in _BY_LINE:
                _refuse_short(message, code=self._kind == ".trc")
            self._frames += 1
            number = message.channel
            channel = str(number + first_channel) if isinstance(number, int) else str(number)
            yield channel, _frame(message, start_ns)
        if requests := getattr(self._file, "requests", 0):
            self.notes.append(f"{requests} requests to send (TxRq) are left out")

    def _open(self) -> tuple[Any, int]:
        import can

        if self._kind == ".blf":
            self._file = self._path.open("rb")
            reader = can.BLFReader(self._file)
            start_ns = round(reader.start_timestamp * 1000) * 1_000_000
            reader.start_timestamp = 0.0  # so that a float holds every stamp exactly
            return reader, start_ns
        if self._kind == ".mf4":
            with needs_extra(self._path, "mf4"):
                import asammdf  # noqa: F401  # python-can's reader needs it
            return tell_format(can.MF4Reader(self._path)), 0
        if self._kind == ".trc":
            self._file = TextLines(self._path)
            return _trc_reader(self._file), 0
        self._file = AscLines(self._path)
        return can.ASCReader(self._file), 0

    def _position(self) -> int:
        if self._file is None or self._file.closed:
            return self._size if self._frames else 0
        return int(getattr(self._file, "buffer", self._file).tell())

    def _at_end(self) -> bool:
        """Whether nothing follows: the logger was stopped in the middle of a frame."""
        return self._file is not None and not self._file.read(_MUCH).strip()

    def _broken(self, error: Exception) -> InputError:
        kind = self._kind.removeprefix(".").upper()
        problem = f"is not readable as {kind} ({type(error).__name__})"
        if isinstance(self._file, AscLines) and self._file.has_names():
            problem = "has a message's name in place of an id"
            return InputError(self._path, self.place, problem, "export it with numeric ids")
        if isinstance(error, _ShortError):
            problem = "a frame has fewer bytes than its length says"
            return InputError(self._path, self.place, problem, "export or record it again")
        place = f"after {self.place}" if self._frames else ""
        return InputError(self._path, place, problem, "export or record it again")


def _trc_reader(file: TextLines) -> Any:
    """python-can's, which by itself leaves out lines that end too early and says nothing."""
    import can

    class Reader(can.TRCReader):
        def _parse_line(self, line: str) -> Any:
            try:
                return self._parse_cols(tuple(line.split(maxsplit=self._num_columns)))
            except IndexError:
                if _EVENT.match(line):
                    raise _ShortError from None
                return None

    return Reader(file)


def _refuse_short(message: Any, *, code: bool) -> None:
    """``code``: the reader gives the length of a CAN FD frame as its code, and not in bytes."""
    if message.is_remote_frame or message.is_error_frame:
        return
    length = message.dlc if message.is_fd else min(message.dlc, 8)
    if message.is_fd and code:
        from can.util import dlc2len

        length = dlc2len(length)
    if len(message.data) < length:
        raise _ShortError


def _frame(message: Any, start_ns: int) -> Frame:
    seconds = message.timestamp
    exact = abs(seconds) < _RELATIVE_S and not start_ns
    t_ns = round(seconds * _NS) if exact else round(seconds * 1e6) * 1000
    # python-can's ASC reader takes a CAN FD frame without data for a remote request
    remote = message.is_remote_frame and bool(message.dlc or not message.is_fd)
    return Frame(
        t_ns=start_ns + t_ns,
        can_id=message.arbitration_id,
        data=b"" if remote else bytes(message.data),
        extended=message.is_extended_id,
        fd=message.is_fd,
        error=message.is_error_frame,
        own=not message.is_rx,
        remote=remote,
        brs=message.bitrate_switch,
        esi=message.error_state_indicator,
        remote_length=min(message.dlc, 8) if remote else 0,
    )


@contextlib.contextmanager
def quiet_libraries() -> Iterator[None]:
    """Keep what python-can and asammdf log about odd files away from the user."""
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)
