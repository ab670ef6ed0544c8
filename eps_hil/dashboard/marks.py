"""Marks that a person sets while looking: a line of JSON each, in a file beside the recording."""

import json
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from eps_hil import json_text
from eps_hil.errors import InputError

_LONGEST, _MOST = 200, 2000
_LAST_NS = 9_000_000_000 * 10**9
"""The year 2255: as far as nanoseconds are counted."""


def marks_path(recording: Path) -> Path:
    """``bus.log`` -> ``bus.log.marks.jsonl``."""
    return recording.with_name(recording.name + ".marks.jsonl")


@dataclass(frozen=True, slots=True)
class Mark:
    """``t_ns``: physical instant, by the clock of the frames' stamps."""

    t_ns: int
    text: str

    @property
    def has_time(self) -> bool:
        """Whether the calendar has this instant."""
        return 0 <= self.t_ns < _LAST_NS

    def as_json(self) -> dict[str, Any]:
        """As a line of the file holds it."""
        utc = datetime.fromtimestamp(self.t_ns * 1e-9, UTC).isoformat(timespec="milliseconds")
        return {"t_ns": self.t_ns, "utc": utc, "text": self.text}


class Marks:
    """All marks, those of the file among them; ``path`` None: they are kept in memory alone."""

    def __init__(self, path: Path | None) -> None:
        """:class:`InputError` for a file that is none of marks, or cannot be read."""
        self.path = path
        self.marks: list[Mark] = []
        if path is not None and path.exists():
            try:
                lines = path.read_text(encoding="utf-8").splitlines()
            except (OSError, UnicodeDecodeError) as error:
                said = getattr(error, "strerror", None) or "it is not UTF-8"
                raise InputError(path, "", f"cannot be read: {said}", "name another file") from None
            self.marks += [_read(path, number, line) for number, line in enumerate(lines, 1)]

    def add(self, t_ns: int, text: str) -> str:
        """Keep one; what went wrong in words, "" for nothing."""
        if len(self.marks) >= _MOST:
            return f"there are {_MOST} marks already"
        clean = " ".join("".join(c if c.isprintable() else " " for c in text).split())
        mark = Mark(t_ns, clean[:_LONGEST])
        if not mark.has_time:
            return f"{t_ns} ns is no time of this clock"
        if self.path is not None:
            line = json.dumps(mark.as_json(), ensure_ascii=False) + "\n"
            try:
                with self.path.open("a", encoding="utf-8") as file:
                    file.write(line)
            except OSError as error:
                return f"{self.path}: {error.strerror}"
        self.marks.append(mark)
        return ""

    def as_json(self) -> list[dict[str, Any]]:
        """For the page."""
        return [mark.as_json() for mark in self.marks]


def _read(path: Path, number: int, line: str) -> Mark:
    try:
        found = json_text.parse(line)
        mark = Mark(int(found["t_ns"]), str(found["text"])[:_LONGEST])
    except (ValueError, TypeError, KeyError, OverflowError):
        mark = Mark(-1, "")
    if not mark.has_time:
        raise InputError(
            path, f"line {number}", "is no mark", 'write {"t_ns": 0, "text": "..."} or name another'
        )
    return mark
