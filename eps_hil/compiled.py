"""``njit`` with a disk cache that can be trusted.

numba's own cache looks only at the file that a function stands in: change a function that is
called from another file, and the caller goes on running the old machine code. Here the cache
folder is named by a hash over every source file of this package that compiles anything, so a
change anywhere, an upgrade or a ``git pull``, can never leave stale physics behind.
"""

import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar, overload

import numba

_KEPT_FOLDERS = 4


def _cache_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "eps_hil" / "compiled"


def _source_hash() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        text = source.read_bytes()
        if b"njit" in text:
            digest.update(source.name.encode() + text)
    return digest.hexdigest()[:16]


def _prepare() -> None:
    folder = _cache_folder() / _source_hash()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        others = sorted(folder.parent.iterdir(), key=lambda p: p.stat().st_mtime, reverse=True)
        for stale in others[_KEPT_FOLDERS:]:
            shutil.rmtree(stale, ignore_errors=True)
    except OSError:
        return  # a read-only home: numba then compiles each time, correctly
    if not os.environ.get("NUMBA_CACHE_DIR"):
        numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]


_prepare()


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
    decorate: Any = numba.njit(cache=True, nogil=True, inline=inline, error_model=error_model)
    chosen: F | Callable[[F], F] = decorate if function is None else decorate(function)
    return chosen
