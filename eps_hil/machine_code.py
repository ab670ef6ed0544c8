"""Where machine code is kept on disk, and which of it is that of these sources.

numba's own cache looks only at the file that a function stands in: change a function that is
called from another file, and the caller goes on running the old machine code. Here a function's
files are named by a hash over numba's version and over every source that its code is made of
(:mod:`eps_hil.sources`), and found by the records' fields of its arguments: an edit, an upgrade or
a ``git pull`` can never leave stale physics behind, and what an edit does not touch is not
compiled again. A function that is not found among the sources goes by a hash over all of them.
"""

import contextlib
import functools
import hashlib
import itertools
import json
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.core.caching import CompileResultCacheImpl, FunctionCache

_KEPT = 4
"""Of other versions' folders, and of the last sources' machine code within one."""
_KEPT_LISTS = 64
_LONGEST_WAIT_S, _LOOK_S = 300.0, 0.02
"""For code that another process compiles: then it is compiled here too."""
_BACKGROUND_NICE = 5
_PACKAGE = Path(__file__).resolve().parent
_COMPILER = f"{_PACKAGE.name}.compiled"
_DIGEST = re.compile(r"-([0-9a-f]{16})(?:\.|$)")

Rows = list[tuple[int, int, list[str], str]]
"""Of a module's top-level statements: first line, last line, names that it binds, digest."""


def _bases() -> Iterator[Path]:
    """Folders to try: the one that numba is told, the user's cache, one of the user's in /tmp."""
    said = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    if said:
        yield Path(said)
    else:
        with contextlib.suppress(RuntimeError):  # a user without a home
            yield Path.home() / ".cache"
    if hasattr(os, "getuid"):
        yield from _private()


def _private() -> Iterator[Path]:
    with contextlib.suppress(OSError):
        private = Path(tempfile.gettempdir()) / f"eps_hil-{os.getuid()}"
        private.mkdir(mode=0o700, exist_ok=True)
        found = private.lstat()
        # what lies in a cache is executed: never read one that somebody else could have made
        if (
            stat.S_ISDIR(found.st_mode)
            and found.st_uid == os.getuid()
            and not found.st_mode & 0o077
        ):
            yield private


def _folder() -> Path | None:
    """The folder of this numba's machine code, made if need be; None if none can be written."""
    for base in _bases():
        folder = base / "eps_hil" / "compiled" / f"numba-{numba.__version__}"
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
            os.utime(folder)
            for stale in _newest(folder.parent.iterdir())[_KEPT:]:
                shutil.rmtree(stale, ignore_errors=True)
            return folder
    return None


def _newest(paths: Iterable[Path]) -> list[Path]:
    """The newest first; another process may be deleting some."""
    dated = []
    for path in paths:
        with contextlib.suppress(OSError):
            dated.append((path.stat().st_mtime_ns, path))
    return [path for _, path in sorted(dated, reverse=True)]


FOLDER = _folder()
"""Where compiled functions are kept; None: nowhere."""


@functools.cache
def _paths() -> list[str]:
    """The package's sources, within it."""
    found = []
    for folder, below, files in os.walk(_PACKAGE):
        below[:] = [name for name in below if name != "__pycache__"]
        place = Path(folder).relative_to(_PACKAGE)
        found += [(place / name).as_posix() for name in files if name.endswith(".py")]
    return sorted(found)


@functools.cache
def _text(path: str) -> bytes:
    return (_PACKAGE / path).read_bytes()


def _hash(paths: Iterable[str]) -> str:
    """Of numba's version, the names of all sources, and what stands in these."""
    digest = hashlib.sha256("\0".join([numba.__version__, *_paths()]).encode())
    for path in paths:
        text = _text(path)
        digest.update(f"\0{path}\0{len(text)}\0".encode() + text)
    return digest.hexdigest()[:16]


@functools.cache
def _whole() -> str:
    return _hash(_paths())


def _kept_statements(folder: Path) -> dict[str, Rows] | None:
    """As :func:`_read_sources`, as it once found them; None: never for these sources."""
    with contextlib.suppress(OSError, ValueError):
        read = json.loads((folder / f"{_hash(())}.read").read_text())
        kept = folder / f"{_hash(read)}.made"
        found: dict[str, Rows] = json.loads(kept.read_text())
        os.utime(kept)
        return found
    return None


@functools.cache
def _read_sources() -> dict[str, Rows]:
    """The statements that compile functions, of each module that has any; kept for the next.

    Which sources were read for it depends on them alone: any other may change.
    """
    from eps_hil.sources import Sources

    texts = {path: _text(path) for path in _paths()}
    wanted = [path for path, text in texts.items() if _COMPILER.encode() in text]
    try:
        sources = Sources(texts, _PACKAGE.name, numba.__version__)
        found: dict[str, Rows] = {
            path: [(one.first, one.last, list(one.names), one.digest) for one in statements]
            for path, statements in sources.statements(wanted).items()
        }
    except (SyntaxError, ValueError):  # a source that nobody imports, half written
        return {}
    if FOLDER is not None:
        with contextlib.suppress(OSError):
            _keep(FOLDER / "sources", sorted(sources.read), found)
            _forget_old(FOLDER)
    return found


def _keep(folder: Path, read: list[str], found: dict[str, Rows]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in ((f"{_hash(read)}.made", found), (f"{_hash(())}.read", read)):
        unfinished = folder / f"{name}.{secrets.token_hex(4)}"
        unfinished.write_text(json.dumps(content))
        unfinished.replace(folder / name)


def _forget_old(folder: Path) -> None:
    """Delete the machine code that none of the last few sources has."""
    alive: set[str] = set()
    different: set[str] = set()
    for place, kept in enumerate(_newest((folder / "sources").glob("*.made"))):
        with contextlib.suppress(OSError):
            content = kept.read_text()
            if place < _KEPT_LISTS and (content in different or len(different) < _KEPT):
                different.add(content)
                alive.update(re.findall(r'"([0-9a-f]{16})"', content))
            else:
                kept.unlink()
    for stale in _newest((folder / "sources").glob("*.read"))[_KEPT_LISTS:]:
        stale.unlink(missing_ok=True)
    for file in itertools.chain((folder / "functions").rglob("*"), (folder / "locks").glob("*")):
        digest = _DIGEST.search(file.name)
        if digest is not None and digest[1] not in alive:
            file.unlink(missing_ok=True)


@functools.cache
def _statements() -> dict[str, Rows]:
    kept = None if FOLDER is None else _kept_statements(FOLDER / "sources")
    return _read_sources() if kept is None else kept


def _digests(path: str, name: str) -> set[str]:
    """Of the statements that bind a name at the top level of the module at ``path``."""
    return {digest for _, _, names, digest in _statements().get(path, []) if name in names}


def indices(path: str, name: str) -> Iterator[Path]:
    """Files that say for which arguments a function is kept, compiled of these sources."""
    if FOLDER is not None:
        place = (FOLDER / "functions" / path).with_suffix("")
        for digest in _digests(path, name):
            yield from place.glob(f"*.{name}-*-{digest}.*.nbi")


def lock_of(path: str, name: str) -> Path | None:
    """A file for whoever wants to compile a function alone; None: nothing is kept."""
    if FOLDER is None:
        return None
    place = FOLDER / "locks" / "-".join([f"ahead_{name}", *sorted(_digests(path, name))])
    place.parent.mkdir(parents=True, exist_ok=True)
    return place


class _Place:
    """Where a function's files are, and what their names say; numba calls it a locator."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._py_file = function.__code__.co_filename
        source, line = Path(self._py_file).resolve(), function.__code__.co_firstlineno
        if source.is_relative_to(_PACKAGE):
            path = source.relative_to(_PACKAGE).as_posix()
            self.digest, place = _digest_of(path, line), Path(path).with_suffix("")
        else:
            own = hashlib.sha256(_whole().encode() + source.read_bytes()).hexdigest()[:16]
            where = hashlib.sha256(str(source.parent).encode()).hexdigest()[:16]
            self.digest, place = own, Path("elsewhere", where, source.stem)
        assert FOLDER is not None
        self._folder, self._line = FOLDER / "functions" / place, line

    def ensure_cache_path(self) -> None:
        """Make the folder."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """The module's folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """The name of a file says which sources it is of."""
        return ""

    def get_disambiguator(self) -> str:
        """Where the function begins, and what it is made of."""
        return f"{self._line}-{self.digest}"


def _digest_of(path: str, line: int) -> str:
    for statements in (_statements, _read_sources):
        for first, last, _, digest in statements().get(path, []):
            if first <= line <= last:
                return digest
    return _whole()


class _Files(CompileResultCacheImpl):
    def __init__(self, function: Callable[..., Any]) -> None:
        self._lineno = function.__code__.co_firstlineno
        self._locator = _Place(function)
        name = f"{Path(function.__code__.co_filename).stem}.{function.__qualname__}"
        name_it: Any = self.get_filename_base
        self._filename_base = name_it(name, getattr(sys, "abiflags", ""))


_MINE = secrets.token_hex(4)
"""In the name of code that this process writes: nobody writes over it."""


class Cache(FunctionCache):
    """A function's code on disk: of several processes that want it at once, one compiles.

    The others wait for it; a process that dies lets go. A folder that knows no locks has none.
    Nobody waits for a process in the background, which may stand still on a busy machine.
    """

    _impl_class = _Files

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        base = self._impl.filename_base
        self._cache_file._data_name_pattern = f"{base}.{_MINE}-{{number:d}}.nbc"
        cells = function.__closure__ or ()
        self.identity = repr(
            (function.__module__, base, [_identity(cell.cell_contents) for cell in cells])
        )
        assert FOLDER is not None
        name = f"{function.__module__}.{function.__qualname__}".replace("<locals>", "in")
        self._locked = FOLDER / "locks" / f"{name}-{self._impl.locator.digest}"
        self._lock: Any = None

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        """What tells one compilation of these sources from another; in words, which no change of
        a class makes unreadable."""
        given = ", ".join(map(_described, getattr(sig, "args", sig)))
        return given, str(getattr(sig, "return_type", "")), codegen.magic_tuple(), self.identity

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code from disk; None: compile it, and :meth:`let_go` when it is there."""
        load: Any = super().load_overload
        found = load(sig, target_context)
        if found is not None or self._lock is not None:
            return found
        with contextlib.suppress(OSError, ImportError):
            self._lock = _locked(self._locked)
        found = load(sig, target_context)
        if found is None:
            tell()
            if os.nice(0) >= _BACKGROUND_NICE:
                self.let_go()
        return found

    def let_go(self) -> None:
        """Let others in."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def _described(kind: Any) -> str:
    """A type in words that say all that machine code depends on; never the same: none known."""
    if isinstance(kind, _TYPES.BaseNamedTuple):
        made = kind.instance_class
        inside = [
            f"{name}: {_described(each)}"
            for name, each in zip(made._fields, kind.types, strict=True)
        ]
        return f"{made.__module__}.{made.__qualname__}({', '.join(inside)})"
    if isinstance(kind, _TYPES.BaseTuple):
        return f"({', '.join(map(_described, kind.types))})"
    if isinstance(kind, _IN_WORDS):
        return f"{type(kind).__name__} {kind}"
    return f"{kind} {secrets.token_hex(8)}"


_TYPES: Any = types
_IN_WORDS = (
    types.Number, types.Boolean, types.Array, types.Record, types.NoneType, types.Omitted,
    types.UnicodeType, types.Literal,
)  # fmt: skip
"""Whose name says everything."""


def _identity(value: Any) -> str:
    """What a closure holds, in words; never the same for what another process may see otherwise."""
    kept = getattr(value, "_cache", None)
    if isinstance(kept, Cache):
        return kept.identity
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value)
    return secrets.token_hex(8)


@functools.cache
def tell(why: str = "once after installation") -> None:
    """Once, to a person at a terminal: why nothing seems to happen."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        if sys.stderr.isatty():
            sys.stderr.write(f"compiling, {why}: up to a minute\n")
            sys.stderr.flush()


def _locked(place: Path) -> Any:
    """An open file that no other process has locked, or, after a long wait, any."""
    import fcntl

    place.parent.mkdir(parents=True, exist_ok=True)
    lock = place.open("wb")
    for _ in range(round(_LONGEST_WAIT_S / _LOOK_S)):
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            break
        except BlockingIOError:
            time.sleep(_LOOK_S)
    return lock
