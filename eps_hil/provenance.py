"""Where a result comes from: tool, catalogue, date, command, input files with SHA-256, machine.

The command line says which files it names (:func:`begin`); every page and every JSON file of a
verb then carries :func:`content`. A program that calls the library has no command: null.
"""

import hashlib
import os
import platform
import shlex
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from eps_hil.version import VERSION

_BLOCK = 1 << 20
OUTPUTS = frozenset({
    "--out", "--json", "--report", "--figure", "--write-model", "--write-manoeuvre",
    "--write-effect", "--log-estimates", "--journal",
})  # fmt: skip
"""Options that name what a verb writes: no input of it, even where the file is there already."""

_command: list[tuple[str, tuple[Path, ...]]] = []


def begin(words: Sequence[str]) -> None:
    """Take down the command (without the program's name) and the files that it reads."""
    parts = [  # --model=m.yaml names a file as well
        part for word in words for part in (word.split("=", 1) if word.startswith("--") else [word])
    ]
    named = [
        Path(word)
        for before, word in zip(("", *parts), parts, strict=False)
        if before not in OUTPUTS and not word.startswith("-")
    ]
    files = tuple(dict.fromkeys(path for path in named if _is_file(path)))
    _command[:] = [(shlex.join(["eps-hil", *words]), files)]


def content() -> dict[str, Any]:
    """JSON-ready; a file that went away since has the hash null."""
    command, files = _command[0] if _command else (None, ())
    return {
        "tool": "eps_hil",
        "version": VERSION,
        "catalogue": catalogue(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": command,
        "files": [{"path": str(path), "sha256": _sha256(path)} for path in files],
        "machine": {
            "name": platform.node(),
            "system": platform.platform(),
            "processor": platform.machine(),
            "cores": os.cpu_count(),
            "python": sys.version.split()[0],
        },
    }


def catalogue() -> str:
    """The catalogue's version: first digits of SHA-256 over the files of its effects."""
    digest = hashlib.sha256()
    for path in sorted((Path(__file__).parent / "physics" / "effects").glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # words that no path can be
        return False


def _sha256(path: Path) -> str | None:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(_BLOCK):
                digest.update(block)
    except OSError:
        return None
    return digest.hexdigest()
