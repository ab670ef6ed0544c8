"""The JSON file beside each log: where it came from, what it holds, what it lacks.

It is replaced whole, once a second, after the log itself has reached the disk: so one that was
left by a killed recorder is true, and never claims a frame that the log does not hold.
"""

import hashlib
import importlib.metadata
import json
import os
import platform
import socket
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

SCHEMA = "eps-hil/recording/1"
_PACKAGES = ("eps_hil", "python-can", "cantools", "numpy")


def sidecar_path(log: Path) -> Path:
    """``bus.log`` -> ``bus.log.json``."""
    return log.with_name(log.name + ".json")


def provenance(config: Path | None, dbc: Sequence[Path], others: Sequence[Path]) -> dict[str, Any]:
    """Machine, versions, and every file that says what the frames mean, with its hash."""
    return {
        "host": {
            "name": socket.gethostname(),
            "system": f"{platform.system()} {platform.release()} {platform.machine()}",
            "python": platform.python_version(),
        },
        "versions": {name: _version(name) for name in _PACKAGES},
        "configuration": None if config is None else file_of(config, whole=True),
        "dbc": [file_of(path) for path in dbc],
        "files": [file_of(path) for path in others],
    }


def file_of(path: Path, *, whole: bool = False) -> dict[str, Any]:
    """Path and SHA-256 of a file; ``whole``: its text too."""
    content = path.read_bytes()
    found = {"path": str(path.resolve()), "sha256": hashlib.sha256(content).hexdigest()}
    return found | ({"text": content.decode("utf-8", "replace")} if whole else {})


def clock_now() -> dict[str, Any]:
    """Both clocks at one moment: a step of the first shows as a change of the difference."""
    now_ns = time.time_ns()
    return {"utc": utc(now_ns), "realtime_minus_monotonic_ns": now_ns - time.monotonic_ns()}


def utc(t_ns: int) -> str:
    """ISO 8601, in microseconds."""
    return datetime.fromtimestamp(t_ns / 1e9, UTC).isoformat(timespec="microseconds")


def write_sidecar(path: Path, content: Mapping[str, Any]) -> None:
    """Replace the file; OSError when the disk refuses, and then the old one stands."""
    temporary = path.with_name(f".{path.name}.part")
    try:
        with temporary.open("w", encoding="utf-8") as file:
            json.dump({"schema": SCHEMA, **content}, file, indent=1)
            file.write("\n")
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def sync_folder(folder: Path) -> None:
    """New names reach the disk too."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
