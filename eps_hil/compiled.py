"""``njit`` with a disk cache that can be trusted.

numba's own cache looks only at the file that a function stands in: change a function that is
called from another file, and the caller goes on running the old machine code. Here the cache
folder is named by a hash over every source file of this package that compiles anything, so a
change anywhere, an upgrade or a ``git pull``, can never leave stale physics behind.

Where no folder can be written (a rig PC with a read-only home), functions are compiled anew by
every process: slower, and just as right.
"""

import contextlib
import functools
import hashlib
import importlib.util
import inspect
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, TypeVar, overload

import numba

from eps_hil import within

_KEPT_FOLDERS = 4
_LONGEST_WAIT_S, _LOOK_S, _LATE_S = 300.0, 0.02, 1.0
_BACKGROUND_NICE = 5
"""From here on others do not wait for what a process compiles, and compile it too."""
_SECOND_NS = 1_000_000_000
_PACKAGE = Path(__file__).resolve().parent
_COMPILED = b"eps_hil.compiled import", b"# frozen into compiled code"
"""What marks a source as one that machine code depends on; the second one, constants."""

_INLINED = ("eps_hil.estimation.", "eps_hil.physics.friction", "eps_hil.physics.effects.added",
            "eps_hil.physics.effects.effect")  # fmt: skip
"""Modules whose kernels become part of what calls them: the step of the estimator.

A call passes tens of records of arrays by value, which takes longer than what it does. Not more:
a call that is spread out is compiled again wherever it stands.
"""


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


def _source_hash() -> str:
    digest = hashlib.sha256(f"{numba.__version__} {within.usable()}".encode())
    for source in sorted(_PACKAGE.rglob("*.py")):
        text = source.read_bytes()
        if any(mark in text for mark in _COMPILED):
            digest.update(str(source.relative_to(_PACKAGE)).encode() + text + _doubtful(source))
    return digest.hexdigest()[:16]


def _doubtful(source: Path) -> bytes:
    """Bytecode that may be of an earlier text: it is put away, and machine code of it kept apart.

    Python knows a text by its length and the second of its last change. Of two changes within one
    second the bytecode may be the first one's, which the name of the folder would vouch for.
    """
    # none there, not ours to remove, or a Python that keeps none: then nothing can be stale here
    with contextlib.suppress(OSError, NotImplementedError):
        kept = Path(importlib.util.cache_from_source(str(source)))
        changed, written = source.stat().st_mtime_ns, kept.stat().st_mtime_ns
        if written <= changed and written // _SECOND_NS == changed // _SECOND_NS:
            found = kept.read_bytes()
            kept.unlink()
            return found
    return b""


def _folder() -> Path | None:
    """The folder of this source's machine code, made if need be; None if none can be written."""
    name = _source_hash()
    for base in _bases():
        folder = base / "eps_hil" / "compiled" / name
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
            os.utime(folder)
            _forget_old(folder.parent)
            return folder
    return None


def _forget_old(parent: Path) -> None:
    with contextlib.suppress(OSError):  # another process may be forgetting the same
        others = sorted(parent.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
        for stale in others[_KEPT_FOLDERS:]:
            shutil.rmtree(stale, ignore_errors=True)


FOLDER = _folder()
"""Where compiled functions are kept; None: nowhere."""
_OFTEN = "once" if FOLDER else "each time, for no cache folder can be written (set NUMBA_CACHE_DIR)"
COMPILING = f"compiling for this machine, {_OFTEN}: some seconds, or minutes where all is missing"
"""What is said of it."""


F = TypeVar("F", bound=Callable[..., Any])


@overload
def njit(function: F, /) -> F: ...


@overload
def njit(
    *,
    inline: Literal["never", "always"] = "never",
    error_model: Literal["python", "numpy"] = "python",
) -> Callable[[F], F]: ...


def njit(
    function: F | None = None,
    /,
    *,
    inline: Literal["never", "always"] = "never",
    error_model: Literal["python", "numpy"] = "python",
) -> F | Callable[[F], F]:
    """:func:`numba.njit`, cached on disk in the folder that this package's sources name.

    ``error_model``: what a division by zero does; only "numpy" (an infinity, no exception) lets
    a loop with divisions run on several numbers at once.
    """
    decorate = _decorator(inline=inline, error_model=error_model, _nrt=True)
    return decorate if function is None else decorate(function)


@overload
def kernel(function: F, /) -> F: ...


@overload
def kernel(*, inline: Literal["never", "always"] = "never") -> Callable[[F], F]: ...


def kernel(
    function: F | None = None, /, *, inline: Literal["never", "always"] = "never"
) -> F | Callable[[F], F]:
    """As :func:`njit`, without counting references to arrays: for the hot path.

    Such a function works on the arrays that it is given. It makes none (numba refuses to compile
    it then) and must return none: nobody would own what it returns. What it calls is a kernel
    too, or pays for its own counting.
    """

    def decorate(kernel: F) -> F:
        hot = kernel.__module__.startswith(_INLINED)
        model = "numpy" if hot else "python"  # whether each division looks for a zero
        return _decorator(inline=inline, forceinline=hot, error_model=model, _nrt=False)(kernel)

    return decorate if function is None else decorate(function)


_CONFIG: Any = numba.config
_made: list[str] = []
"""Names of the functions that are there to be compiled."""


def _decorator(**options: Any) -> Callable[[F], F]:
    options |= {"nogil": True}

    def decorated(function: F) -> F:
        _made.append(function.__qualname__)
        digest = _held(function)
        if digest is not None:  # numba tells machine code of one name apart in one process only
            function.__qualname__ = f"{function.__qualname__}_{digest[:12]}"
        with _cached_there(function):
            try:
                compiled: F = numba.njit(cache=FOLDER is not None, **options)(function)
            except RuntimeError:  # numba finds no folder that it may write to after all
                return numba.njit(**options)(function)
        if FOLDER is not None:
            _compile_once(compiled, FOLDER / "locks", digest)
        else:
            _say_each_time(compiled)
        within.only_part(compiled)
        return compiled

    return decorated


def interpret() -> bool:
    """Let kernels run as Python in this process; False where some are there already.

    For one short answer before anything is compiled; the bits are the same.
    """
    if _made:
        return False
    _CONFIG.DISABLE_JIT = 1
    return True


def interpreted() -> bool:
    """Whether kernels run as Python."""
    return bool(_CONFIG.DISABLE_JIT)


def direct(function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
    """The machine code of a compiled ``function`` for arguments of these very types.

    Calling the function itself finds out the types of all arguments first, which for records of
    arrays takes several times as long as the step of an estimator. Compiles (or loads) where need
    be, and calls nothing. Whoever calls the result answers for the types.
    """
    compile_for = getattr(function, "compile", None)
    type_of: Any = numba.typeof
    if compile_for is None:  # compilation is switched off
        return function
    entry: Callable[..., Any] = compile_for(tuple(type_of(each) for each in arguments))
    return entry


class Locator:
    """Tells numba where a function of this package is kept, wherever the package is installed.

    numba's own locators know a file by its path and by when it was changed, so that a checkout, a
    wheel and every ``git switch`` compile anew what the folder's name says is the same source.
    (numba before 0.62 does not ask; it then goes by path and date, as it does for other files.)
    """

    def __init__(self, folder: Path, line: int) -> None:
        self._folder, self._line = folder, line

    @classmethod
    def from_function(cls, function: Callable[..., Any], source: str) -> "Locator":
        """Called by numba when it decorates."""
        if FOLDER is None:
            raise RuntimeError("no folder to keep compiled functions in")
        place = Path(source).resolve().relative_to(_PACKAGE).with_suffix("")
        return cls(FOLDER / "functions" / place, function.__code__.co_firstlineno)

    def ensure_cache_path(self) -> None:
        """Make the folder."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """The function's folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """The name of the folder above says which source it is."""
        return ""

    def get_disambiguator(self) -> str:
        """As numba does it: the line where the function begins."""
        return str(self._line)


class _Kept:
    """A function's code on disk: of several that want it for the same types at once, one compiles.

    The others wait for it; a process that dies lets go. A folder that knows no locks has none.
    For a process in the background, which may stand still on a busy machine, only those wait that
    are just as nice.
    """

    def __init__(self, cache: Any, place: Path) -> None:
        self._cache, self._place = cache, place
        self._locks: dict[Any, Any] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The code from disk; None: compile it, and :meth:`let_go` when it is there."""
        found = self._cache.load_overload(signature, context)
        if found is not None or signature in self._locks:
            return found
        place = self._place.with_name(f"{self._place.name}.{_types(signature)}")
        with contextlib.suppress(OSError, ImportError):
            self._locks[signature] = _locked(place)
        found = self._cache.load_overload(signature, context)
        niceness = os.nice(0)
        if found is None and niceness >= _BACKGROUND_NICE:
            self.let_go(signature)
            with contextlib.suppress(OSError, ImportError):
                self._locks[signature] = _locked(place.with_name(f"{place.name}.nice{niceness}"))
            found = self._cache.load_overload(signature, context)
        if found is None:
            _tell(COMPILING)
        return found

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """The code to disk, one process at a time: numba numbers files by what it read before."""
        lock = None
        with contextlib.suppress(OSError, ImportError):
            lock = _locked(self._place.with_name(f"{self._place.name}.save"))
        try:
            self._cache.save_overload(signature, compiled)
        finally:
            if lock is not None:
                lock.close()

    def let_go(self, signature: Any) -> None:
        """Let others in."""
        lock = self._locks.pop(signature, None)
        if lock is not None:
            lock.close()


def _types(signature: Any) -> str:
    """A name of the types, in all processes the same."""
    return hashlib.sha256(re.sub("0x[0-9a-f]+", "", repr(signature)).encode()).hexdigest()[:16]


_logs_too: list[bool] = []
_waited_s = [0.0]


def tell_logs_too() -> None:
    """From here on a wait for another process is told where stderr is no terminal, too."""
    _logs_too.append(True)


@functools.cache
def _tell(line: str, *, logs_too: bool = False) -> None:
    """Once, to a person at a terminal: why nothing seems to happen."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        if logs_too or sys.stderr.isatty():
            sys.stderr.write(f"{line}\n")
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
            _waited_s[0] += _LOOK_S
            if _waited_s[0] > _LATE_S:
                _tell("waiting for code that another process compiles", logs_too=bool(_logs_too))
    return lock


def _compile_once(function: Any, folder: Path, digest: str | None) -> None:
    """Let processes that start together, on an empty cache, share the work."""
    compile_for = getattr(function, "compile", None)
    if compile_for is None:  # compilation is switched off
        return
    _know_by_content(function, digest)
    name = f"{function.__module__}.{function.__qualname__}"
    kept = _Kept(function._cache, folder / name.replace("<locals>", "in"))

    def compiled(signature: Any) -> Any:
        try:
            return compile_for(signature)
        finally:
            kept.let_go(signature)

    function._cache, function.compile = kept, compiled


def _know_by_content(function: Any, digest: str | None) -> None:
    """Let a closure's code on disk be found by what the closure holds.

    numba pickles what it holds: compiled functions with an id that every process draws anew, and
    with what they were compiled for so far. No process would find what another has compiled.
    """
    if digest is None or not hasattr(function._cache, "_index_key"):
        return
    code = hashlib.sha256(function.py_func.__code__.co_code).hexdigest()

    def key(signature: Any, codegen: Any) -> Any:
        return signature, codegen.magic_tuple(), (code, digest)

    function._cache._index_key = key


def _held(function: Callable[..., Any]) -> str | None:
    """A digest of what a closure holds; None: it is none, or holds what no name vouches for."""
    if function.__closure__ is None:
        return None
    try:
        held = [_content(cell.cell_contents) for cell in function.__closure__]
    except ValueError:
        return None
    return hashlib.sha256(repr(held).encode()).hexdigest()


def _content(held: Any) -> Any:
    """Plain numbers and words, and functions of this package with what they hold themselves."""
    if held is None or isinstance(held, bool | int | float | str):
        return held
    function = getattr(held, "py_func", held)
    if not inspect.isfunction(function):
        raise ValueError("neither a number nor a function")
    if not Path(inspect.getfile(function)).resolve().is_relative_to(_PACKAGE):
        raise ValueError("of another package, whose sources the folder's name does not know")
    within = [_content(cell.cell_contents) for cell in function.__closure__ or ()]
    given = [_content(each) for each in function.__defaults__ or ()]
    code = function.__code__
    if any(inspect.iscode(each) for each in code.co_consts):  # shown by its place in memory
        raise ValueError("holds another function's text")
    itself = code.co_firstlineno, code.co_code, code.co_names, code.co_consts
    return function.__module__, function.__qualname__, itself, within, given


def _say_each_time(function: Any) -> None:
    """Where nothing can be kept: every process compiles, and says so."""
    compile_for = getattr(function, "compile", None)
    if compile_for is None:  # compilation is switched off
        return

    def compiled(signature: Any) -> Any:
        _tell(COMPILING)
        return compile_for(signature)

    function.compile = compiled


@contextlib.contextmanager
def _cached_there(function: Callable[..., Any]) -> Iterator[None]:
    """numba looks for its folder when it decorates: ours is told then, and to nobody else."""
    ours = Path(inspect.getfile(function)).resolve().is_relative_to(_PACKAGE)
    told = {
        "CACHE_DIR": str(FOLDER or ""),
        "CACHE_LOCATOR_CLASSES": f"{__name__}.{Locator.__name__}" if ours and FOLDER else "",
    }
    before = {name: getattr(numba.config, name, "") for name in told}
    for name, value in told.items():
        setattr(numba.config, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(numba.config, name, value)
