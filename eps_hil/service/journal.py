"""Transitions and friction levels as lines of JSON, each handed to the system at once.

Appended, so that one file holds the story of a rig. What was written survives the process, however
it ends; it is not forced onto the disk, for the loop must not wait for one.
"""

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from eps_hil import json_text
from eps_hil.errors import InputError
from eps_hil.estimation.levels import LevelChange
from eps_hil.service.guard import Trip
from eps_hil.service.override import Transition
from eps_hil.service.whole_lines import WholeLines


def as_json(transition: Transition, wall_ns: int) -> dict[str, Any]:
    """One transition; ``utc`` by the wall clock, ``t_ns`` by the session's steady one."""
    stamp = datetime.fromtimestamp(wall_ns * 1e-9, UTC).isoformat(timespec="milliseconds")
    return {
        "utc": stamp,
        "t_ns": transition.t_ns,
        "from": transition.before.name.lower(),
        "to": transition.after.name.lower(),
        "why": transition.why,
        "trips": [bit.name.lower() for bit in Trip if bit & transition.trips and bit.name],
        "input_verdict": int(transition.reason),
    }


def level_changes(path: Path) -> list[LevelChange]:
    """The friction levels that a journal says were taken, by their instants.

    :class:`InputError` names the line of what is no journal.
    """
    found = []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "", f"cannot be read: {error}", "name a journal of run") from None
    for number, line in enumerate(lines, start=1):
        try:
            event = json_text.parse(line)
            if event.get("levels") == "taken":
                levels = float(event["offset_pos_nm"]), float(event["offset_neg_nm"])
                found.append(LevelChange(int(event["t_ns"]), *levels))
        except (ValueError, KeyError, TypeError, AttributeError):
            raise InputError(
                path, f"line {number}", "is no event of a journal", "name a journal of run"
            ) from None
    return sorted(found)


class Journal:
    """An open journal; ``path`` None: nothing is kept. :class:`InputError` if not writable."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        try:
            self._file = None if path is None else WholeLines(path, "a")
        except OSError as error:
            raise InputError(path, "", f"cannot be written: {error.strerror}") from None

    @property
    def closed(self) -> bool:
        """Whether nothing is kept."""
        return self._file is None

    def note(self, event: dict[str, Any]) -> None:
        """One line; OSError where the disk refuses it."""
        if self._file is not None:
            self._file.append(json.dumps(event) + "\n")

    def write(self, transitions: Sequence[Transition], wall_ns: int) -> None:
        """The transitions, in order."""
        for transition in transitions:
            self.note(as_json(transition, wall_ns))

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
