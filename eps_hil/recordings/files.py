"""Files as people give them: what can be wrong with one before its format matters."""

import contextlib
import errno
import importlib.util
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from eps_hil.errors import EpsHilError, InputError


def check_readable(path: Path) -> None:
    """Refuse a missing, unreadable or empty file, a folder and a pipe, each with its remedy."""
    with refused_by_system(path):
        if path.is_dir():
            raise InputError(path, "", "is a folder, a recording was expected", "name the file")
        if path.is_fifo():
            problem = "is a pipe, and a recording is read more than once"
            raise InputError(path, "", problem, "write it to a file, and name that")
        with path.open("rb") as file:
            if not file.read(1):
                raise InputError(path, "", "is empty (0 bytes)", "record it again")


def read_bytes(path: Path) -> bytes:
    """The whole file; :class:`InputError` if it cannot be had."""
    check_readable(path)
    with refused_by_system(path):
        return path.read_bytes()


def first_line_and_rest(path: Path) -> tuple[bytes, bytes]:
    """The file up to its first line feed, and what follows that; as :func:`read_bytes`.

    What follows is read by itself: cut off from the whole it would be a second copy.
    """
    check_readable(path)
    with refused_by_system(path):
        with path.open("rb") as file:
            first = file.readline()
        with path.open("rb", buffering=0) as file:
            file.seek(len(first))
            return first.removesuffix(b"\n"), file.readall()


@contextlib.contextmanager
def refused_by_system(path: Path) -> Iterator[None]:
    """Turn what the operating system says about reading ``path`` into one line."""
    try:
        yield
    except FileNotFoundError:
        raise InputError(path, "", "no such file", "check the path") from None
    except PermissionError:
        raise InputError(path, "", "may not be read", "check its permissions") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(path, "", f"cannot be read: {reason}", "check the path") from None


_EXTRAS = {
    ".parquet": ("parquet", "pyarrow"),
    ".mf4": ("mf4", "asammdf"),
    ".mcap": ("mcap", "mcap"),
    ".fmu": ("fmu", "fmpy"),
}
"""Suffix -> extra of pyproject.toml, and the library that it brings."""


def check_extra(path: Path) -> None:
    """Refuse, before any work, a file whose format needs a library that is not installed."""
    extra, library = _EXTRAS.get(path.suffix.lower(), ("", ""))
    if library and importlib.util.find_spec(library) is None:
        raise _extra_missing(path, extra)


@contextlib.contextmanager
def needs_extra(path: Path, extra: str) -> Iterator[None]:
    """Around the import of an optional library: says which extra brings it."""
    try:
        yield
    except ImportError:
        raise _extra_missing(path, extra) from None


def _extra_missing(path: Path, extra: str) -> InputError:
    problem = f"{path.suffix.lower()} files need the '{extra}' extra"
    return InputError(path, "", problem, f'pip install "eps_hil[{extra}]"')


def make_folder(path: Path, option: str) -> None:
    """The folder that ``option`` names, made if it is not there, with those above it."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"cannot be made: {error.strerror}"
        raise InputError(path, option, problem, "choose another folder") from None


def check_writable(path: Path) -> None:
    """Refuse before long work what :func:`replacing` would refuse after it."""
    if _is_stream(path):
        return
    path = path.resolve()
    if path.is_dir():
        raise InputError(path, "", "is a folder, a file name was expected", "name the file")
    _temporary(path).unlink()


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside ``path`` that takes its place when the block ends without error.

    So a reader never meets half a file, and an old file survives a full disk. A device or pipe
    (/dev/null, /dev/stdout) is written into, and stays what it is.
    Raises :class:`InputError` for a folder that is not there or not writable, and
    :class:`EpsHilError` for a disk that is full or fails.
    """
    if _is_stream(path):
        with _written_into(path) as temporary:
            yield temporary
        return
    path = path.resolve()  # through a link to the file it names
    if path.is_dir():
        raise InputError(path, "", "is a folder, a file name was expected", "name the file")
    temporary = _temporary(path)
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise _not_written(path, error) from None
    finally:
        temporary.unlink(missing_ok=True)


def _is_stream(path: Path) -> bool:
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


@contextlib.contextmanager
def _written_into(stream: Path) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        temporary = Path(folder) / f"whole{stream.suffix}"
        temporary.touch()
        yield temporary
        try:
            with temporary.open("rb") as whole, stream.open("wb") as into:
                shutil.copyfileobj(whole, into)
        except BrokenPipeError:  # who read it is gone
            raise
        except OSError as error:
            raise _not_written(stream, error) from None


def _temporary(path: Path) -> Path:
    try:
        handle, name = tempfile.mkstemp(
            suffix=path.suffix, prefix=f".{path.stem}.", dir=path.parent
        )
        os.fchmod(handle, 0o666 & ~_umask())
        os.close(handle)
    except (FileNotFoundError, NotADirectoryError):
        problem = f"folder {path.parent} does not exist"
        raise InputError(path, "", problem, "create it first") from None
    except PermissionError:
        problem = f"folder {path.parent} may not be written"
        raise InputError(path, "", problem, "choose another folder") from None
    except OSError as error:
        raise _not_written(path, error) from None
    return Path(name)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _not_written(path: Path, error: OSError) -> EpsHilError:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return EpsHilError(f"{path}: the disk is full; free some space, nothing was written")
    return EpsHilError(f"{path}: cannot be written: {error.strerror or error}")
