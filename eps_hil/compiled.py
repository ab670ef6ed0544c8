"""``njit`` with a disk cache that can be trusted (:mod:`eps_hil.machine_code`).

Where no folder can be written (a rig PC with a read-only home), functions are compiled anew by
every process: slower, and just as right.
"""

from collections.abc import Callable
from typing import Any, Literal, TypeVar, overload

import numba

from eps_hil import machine_code
from eps_hil.machine_code import FOLDER

_INLINED = ("eps_hil.estimation.", "eps_hil.physics.friction", "eps_hil.physics.effects.added",
            "eps_hil.physics.effects.effect")  # fmt: skip
"""Modules whose kernels become part of what calls them: the step of the estimator.

A call passes tens of records of arrays by value, which takes longer than what it does. Not more:
a call that is spread out is compiled again wherever it stands.
"""


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
    """:func:`numba.njit`, cached on disk by the sources that the function is made of.

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
        return _decorator(inline=inline, forceinline=hot, _nrt=False)(kernel)

    return decorate if function is None else decorate(function)


__all__ = ["FOLDER", "direct", "interpret", "interpreted", "kernel", "njit"]
_CONFIG: Any = numba.config
_made: list[str] = []
"""Names of the functions that are there to be compiled."""


def _decorator(**options: Any) -> Callable[[F], F]:
    def decorated(function: F) -> F:
        _made.append(function.__qualname__)
        compiled: F = numba.njit(nogil=True, **options)(function)
        if hasattr(compiled, "compile"):  # else compilation is switched off
            _keep(compiled, function)
        return compiled

    return decorated


def _keep(compiled: Any, function: Callable[..., Any]) -> None:
    """Let ``compiled`` be kept on disk, or say each time that it is not."""
    compile_for = compiled.compile
    try:
        kept = None if FOLDER is None else machine_code.Cache(function)
    except OSError:  # no source, none that can be read
        kept = None

    def compiled_by_one(signature: Any) -> Any:
        try:
            return compile_for(signature)
        finally:
            if kept is not None:
                kept.let_go()

    def compiled_each_time(signature: Any) -> Any:
        machine_code.tell("each time, for no cache folder can be written (set NUMBA_CACHE_DIR)")
        return compile_for(signature)

    if kept is not None:
        compiled._cache, compiled.compile = kept, compiled_by_one
    elif FOLDER is None:
        compiled.compile = compiled_each_time


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
