"""What programs of this tool are doing right now, for a page that shows it: a file each, in memory.

A calibration or a programme says how far it is, a service or a simulated rig what it waits for.
Saying it is one write into a page of a file that is open already: it waits for nobody, and nobody
has to listen. Only programs of the same user on the same machine can be seen.
"""

import contextlib
import json
import os
import stat
import tempfile
import time
from pathlib import Path
from typing import Any

_SIZE = 4096
"""Of a file: what is written at once is read at once."""
_ENDED_S = 120.0
"""For so long the last word of a program that has ended is shown."""


def folder() -> Path | None:
    """Where notices are: a private folder in memory, else on disk; None: nowhere.

    In memory (the user's runtime folder, /dev/shm) a write never waits for a disk.
    """
    private = f"eps_hil-board-{os.getuid()}"
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    places = [Path(runtime) / "eps_hil"] if runtime else []
    places += [Path("/dev/shm") / private, Path(tempfile.gettempdir()) / private]
    for place in places:
        with contextlib.suppress(OSError):
            place.mkdir(mode=0o700, exist_ok=True)
            found = place.lstat()
            own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
            if own and not found.st_mode & 0o077:
                return place
    return None


class Notice:
    """One program's: ``kind`` is "service", "rig", "calibration" or "programme"."""

    def __init__(self, kind: str, bus: str, title: str) -> None:
        self._fixed = {"kind": kind, "bus": bus, "title": title, "pid": os.getpid()}
        self._path: Path | None = None
        self._file = -1
        place = folder()
        if place is not None:
            with contextlib.suppress(OSError):
                path = place / f"{os.getpid()}-{kind}.json"
                self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
                self._path = path

    def put(self, **content: Any) -> None:
        """Say where it is: ``text``; ``done`` of ``of``; ``gates``. What fails is not said."""
        if self._file < 0:
            return
        with contextlib.suppress(OSError, ValueError, TypeError):
            data = json.dumps({**self._fixed, **content}, allow_nan=False).encode()
            if len(data) <= _SIZE:
                os.pwrite(self._file, data.ljust(_SIZE), 0)

    def end(self, **content: Any) -> None:
        """Take it away; with a last word it is left there for two minutes."""
        if content:
            self.put(ended=True, **content)
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
        if self._path is not None and not content:
            self._path.unlink(missing_ok=True)


def notices(bus: str) -> list[dict[str, Any]]:
    """What programs on this bus say; those of programs that are no more are thrown away."""
    place = folder()
    found = []
    for path in sorted(place.glob("*.json")) if place is not None else []:
        told = _read(path)
        if told is not None and told.get("bus") == bus:
            found.append(told)
    return found


def _read(path: Path) -> dict[str, Any] | None:
    try:
        told: Any = json.loads(path.read_bytes())
        if not isinstance(told, dict):
            return None
        age_s = time.time() - path.stat().st_mtime
        gone = age_s > _ENDED_S if told.get("ended") else not _lives(int(told["pid"]))
        if gone:
            path.unlink(missing_ok=True)
            return None
        return told
    except (OSError, ValueError, KeyError, TypeError):  # just being written, or none of ours
        return None


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
