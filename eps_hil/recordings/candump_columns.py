"""candump logs read at once: lines of one shape become rows of a matrix of characters.

A line's shape is where its parts stand, its interface, and every character between the parts; it
comes from :data:`~eps_hil.recordings.candump.LINE`, matched on the first line that has no shape
yet. So a line is taken here if and only if the frame-by-frame reader takes it. Whatever that
reader would refuse, or is seldom (hundreds of shapes), is left to it: None is returned.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.bus.frame_columns import EXTENDED
from eps_hil.compiled import kernel
from eps_hil.recordings.candump import ERROR_FLAG, ID_MASK, LINE
from eps_hil.recordings.files import refused_by_system
from eps_hil.recordings.frame_parts import Keep, Part

_CHUNK = 1 << 20
_LONGEST = 400
_MOST_SHAPES = 400
_FD_DATA, _FD_FLAGS, _DATA = 7, 6, 8
_NEWLINE, _RETURN = 10, 13
_SECONDS, _FRACTION, _IDENTIFIER, _FLAGS, _PAYLOAD = range(5)
_NS = 1_000_000_000
_HEX = np.full(256, 255, np.uint8)
_HEX[[*b"0123456789ABCDEF"]] = np.arange(16)
_HEX[[*b"abcdef"]] = np.arange(10, 16)

Bytes = npt.NDArray[np.uint8]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


class _Shape(NamedTuple):
    """What stands where in a line.

    ``spans``: first place of each kind and the one after its last, (5, 2). ``fixed``: all other
    places and the characters that stand there, (2, n). ``digits``: of the fraction of a second;
    ``width``: bytes of payload.
    """

    spans: Ints
    fixed: Ints
    digits: int
    width: int
    channel: bytes
    extended: bool
    remote: bool


@kernel
def _number(text: Bytes, begin: int, end: int, base: int, values: Bytes) -> int:
    """Digits as a number; -1 where one of them is none."""
    number = wrong = 0
    for k in range(begin, end):
        digit = int(values[text[k]])
        wrong |= base - 1 - digit
        number = number * base + digit
    return number if wrong >= 0 else -1


@kernel
def _take(
    text: Bytes, starts: Ints, spans: Ints, fixed: Ints, values: Bytes, fits: Bools,
    numbers: Ints, data: Bytes,
) -> int:  # fmt: skip
    """Lines at ``starts`` (n,) that are of a shape: ``fits`` (n,), how many.

    Of those, ``numbers`` (n, 4): seconds, fraction, identifier, flags; and ``data`` (n, width).
    """
    rows, width = 0, data.shape[1]
    for k in range(len(starts)):
        at, wrong = starts[k], 0
        for j in range(fixed.shape[1]):
            wrong |= int(text[at + fixed[0, j]]) ^ fixed[1, j]
        for j in range(_PAYLOAD):
            base = 10 if j <= _FRACTION else 16
            found = _number(text, at + spans[j, 0], at + spans[j, 1], base, values)
            numbers[rows, j] = found
            wrong |= int(found < 0)
        at += spans[_PAYLOAD, 0]
        for j in range(width):
            high, low = int(values[text[at + 2 * j]]), int(values[text[at + 2 * j + 1]])
            wrong |= (high | low) & 0xF0
            data[rows, j] = (high << 4 | low) & 0xFF
        fits[k] = wrong == 0
        rows += fits[k]
    return rows


class CandumpColumns:
    """One log, in chunks of its text."""

    def __init__(self, path: Path, *, keep: Keep) -> None:
        self._path, self._keep = path, keep
        self._shapes: dict[int, list[_Shape]] = {}
        self._lines = 0
        self.notes: list[str] = []
        self.in_order = True

    def parts(self, on_progress: Callable[[float], None] | None) -> Iterator[list[Part] | None]:
        """What each chunk holds; None (and nothing after it) where a line is not plain."""
        size = max(self._path.stat().st_size, 1)
        done, rest = 0, b""
        with refused_by_system(self._path), self._path.open("rb") as file:
            while block := file.read(_CHUNK):
                done += len(block)
                text = rest + block
                end = text.rfind(b"\n") + 1
                rest = text[end:]
                if end:
                    yield self._chunk(np.frombuffer(text, np.uint8, end))
                if on_progress is not None:
                    on_progress(done / size)
        if rest.strip():
            if LINE.fullmatch(rest) is not None:
                yield self._chunk(np.frombuffer(rest + b"\n", np.uint8))
            elif self._lines == 0:
                yield None
            else:
                self.notes.append(f"line {self._lines + 1} is cut off: left out")

    def _chunk(self, text: Bytes) -> list[Part] | None:
        ends = np.flatnonzero(text == _NEWLINE)
        starts = np.concatenate(([0], ends[:-1] + 1))
        long = ends - starts
        long -= (long > 0) & (text[ends - 1] == _RETURN)
        first, self._lines = self._lines, self._lines + len(ends)
        if long.max(initial=0) > _LONGEST:
            return None
        parts: list[Part] = []
        for length in np.flatnonzero(np.bincount(long)).tolist():
            if length == 0:
                continue
            which = np.flatnonzero(long == length)
            if not self._of_length(text, length, starts[which], first + which, parts):
                return None
        return parts

    def _of_length(
        self, text: Bytes, length: int, starts: Ints, number: Ints, parts: list[Part]
    ) -> bool:
        """Lines of one length at ``starts`` into ``parts``; whether all of them are plain."""
        known = self._shapes.setdefault(length, [])
        tried = 0
        while len(starts):
            if tried == len(known):
                line = text[starts[0] : starts[0] + length].tobytes()
                shape = _shape_of(line)
                if shape is None:
                    if line.strip():
                        return False
                    starts, number = starts[1:], number[1:]
                    continue
                if len(known) >= _MOST_SHAPES:
                    return False
                known.append(shape)
            shape = known[tried]
            fits = np.zeros(len(starts), bool)
            numbers = np.empty((len(starts) + 1, _PAYLOAD), np.int64)
            data = np.empty((len(starts) + 1, shape.width), np.uint8)
            many = _take(text, starts, shape.spans, shape.fixed, _HEX, fits, numbers, data)
            if many == len(starts):
                self._keep_of(shape, number, numbers[:many], data[:many], parts)
                return True
            self._keep_of(shape, number[fits], numbers[:many], data[:many], parts)
            starts, number = starts[~fits], number[~fits]
            tried += 1
        return True

    def _keep_of(
        self, shape: _Shape, number: Ints, numbers: Ints, data: Bytes, parts: list[Part]
    ) -> None:
        """What is wanted of lines of a shape."""
        if shape.remote or not len(number):
            return
        identifier = numbers[:, _IDENTIFIER]
        key = identifier & ID_MASK
        kept = self._keep(key, shape.channel)
        if shape.extended:
            kept &= identifier & ERROR_FLAG == 0
            key |= EXTENDED
        t_ns = numbers[:, _SECONDS] * _NS + numbers[:, _FRACTION] * 10 ** (9 - shape.digits)
        if not kept.all():
            number, key, t_ns, data = number[kept], key[kept], t_ns[kept], data[kept]
        if len(key):
            parts.append(
                Part(number, shape.channel, t_ns, key, np.full(len(key), data.shape[1]), data)
            )


def _shape_of(line: bytes) -> _Shape | None:
    match = LINE.fullmatch(line)
    if match is None:
        return None
    payload = _FD_DATA if match[_FD_FLAGS] is not None else _DATA
    groups = (1, 2, 4, _FD_FLAGS, payload)
    spans = np.array([match.span(group) for group in groups], np.int64)
    spans[spans < 0] = 0
    free = np.concatenate([np.arange(*span) for span in spans])
    places = np.delete(np.arange(len(line)), free)
    return _Shape(
        spans, np.array([places, np.frombuffer(line, np.uint8)[places]], np.int64),
        len(match[2]), len(match[payload] or b"") // 2,
        match[3], len(match[4]) == 8, match[5] is not None,
    )  # fmt: skip
