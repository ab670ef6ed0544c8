"""Kernels that are compiled as a part of another one: for that alone, in a fraction of the time.

numba makes of every function that a kernel calls a program of its own: optimised with all that it
calls in turn, translated into machine code, with a wrapper that takes Python's arguments apart. Of
a kernel that calls a hundred others nobody needs more than the last of these programs. Here what
is called is kept as it is written down, and only the kernel that Python calls is optimised and
translated, once, with all of its parts: the same instructions on the same numbers.

Where Python calls one of the parts itself, it is compiled for that, too.

This stands on inner parts of numba. :func:`usable` says whether they are there, in a version that
this was tried on. Elsewhere numba compiles as it always does: slower, with the same numbers.
"""
# frozen into compiled code

import copy
import functools
import importlib
import inspect
import threading
from typing import Any

import numba

_TRIED = {f"0.{series}" for series in range(60, 69)}
"""Series of numba's versions."""
_RELIES_ON: dict[str, tuple[str, ...] | None] = {
    "codegen.JITCodeLibrary._optimize_final_module": ("self",),
    "codegen.JITCodeLibrary._finalize_final_module": ("self",),
    "codegen.JITCodeLibrary._finalize_dynamic_globals": ("self",),
    "codegen.JITCodeLibrary._unserialize": ("codegen", "state"),
    "codegen.JITCodeLibrary.codegen": None,
    "codegen.JITCodeLibrary.enable_object_caching": ("self",),
    "codegen.JITCodeLibrary.serialize_using_bitcode": ("self",),
    "codegen.JITCodeLibrary.serialize_using_object_code": ("self",),
    "codegen.JITCPUCodegen._library_class": None,
    "codegen.JITCPUCodegen.create_library": ("self", "name", "kwargs"),
    "codegen.JITCPUCodegen.set_env": ("self", "env_name", "env"),
    "codegen.JitEngine.get_global_value_address": None,
    "codegen.RuntimeLinker.PREFIX": None,
    "compiler.Compiler.__init__": (
        "self", "typingctx", "targetctx", "library", "args", "return_type", "flags", "locals",
    ),
    "compiler.CompileResult.library": None,
    "compiler.Flags.no_cpython_wrapper": None,
    "compiler.Flags.no_cfunc_wrapper": None,
    "compiler_lock.global_compiler_lock": None,
    "caching.CompileResultCacheImpl.rebuild": ("self", "target_context", "payload"),
    "caching.CompileResultCacheImpl.filename_base": None,
    "caching.CompileResultCacheImpl.locator": None,
    "caching.FunctionCache.cache_path": None,
    "caching.IndexDataCacheFile.__init__": (
        "self", "cache_path", "filename_base", "source_stamp",
    ),
    "dispatcher.Dispatcher.compile": ("self", "sig"),
    "dispatcher.Dispatcher.add_overload": ("self", "cres"),
    "dispatcher.Dispatcher.get_call_template": ("self", "args", "kws"),
    "dispatcher.Dispatcher.get_compile_result": ("self", "sig"),
    "environment.lookup_environment": ("env_name",),
    "sigutils.normalize_signature": ("sig",),
}  # fmt: skip
"""Names in ``numba.core``, with the arguments of those that are functions."""


@functools.cache
def usable() -> bool:
    """Whether this numba is of a series that was tried, with all of its parts that count here."""
    if ".".join(numba.__version__.split(".")[:2]) not in _TRIED:
        return False
    for name, arguments in _RELIES_ON.items():
        module, *path = name.split(".")
        try:
            found: Any = importlib.import_module(f"numba.core.{module}")
            for each in path:
                found = getattr(found, each)
            if arguments is not None and tuple(inspect.signature(found).parameters) != arguments:
                return False
        except (ImportError, AttributeError, TypeError, ValueError):
            return False
    codegen: Any = importlib.import_module("numba.core.codegen")
    same: bool = codegen.JITCPUCodegen._library_class is codegen.JITCodeLibrary
    return same


def only_part(function: Any) -> None:
    """Compile a kernel that another one calls as its part, where numba lets itself be told."""
    if not hasattr(function, "compile") or not usable():  # the first: compilation is switched off
        return
    # our own cache (compiled.py) keeps numba's under the name that a function keeps it under
    owner = function._cache if hasattr(function._cache, "_cache") else function
    numbas = vars(owner._cache)
    if hasattr(function._compiler, "pipeline_class") and (
        not numbas or {"_impl", "_cache_file"} <= numbas.keys()
    ):
        _Apart(function, owner)


class _Work(threading.local):
    """What this thread compiles."""

    def __init__(self) -> None:
        self.parts: list[bool] = []
        """Of all that is in work, the outermost first, whether it is a part."""
        self.asked: Any = None
        """The function that a kernel in work is about to call."""


_work = _Work()


class _Apart:
    """What one function is compiled for: as a part, or as a program that Python may call."""

    def __init__(self, function: Any, owner: Any) -> None:
        self._function, self._owner = function, owner
        self._usual = {
            name: getattr(function, name)
            for name in ("compile", "add_overload", "get_call_template", "get_compile_result")
        }
        self._caches = {False: owner._cache, True: _cache_of_parts(owner._cache)}
        self._pipelines = {False: function._compiler.pipeline_class, True: self._compile_part}
        self._parts: dict[Any, Any] = {}
        self._alive: list[Any] = []
        """What machine code may point at."""
        function.compile = self.compile
        function.add_overload = self.add_overload
        function.get_call_template = self.get_call_template
        function.get_compile_result = self.get_compile_result

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Called where a kernel calls the function. (Ours are called by ours, or by Python.)"""
        _work.asked = self._function
        try:
            return self._usual["get_call_template"](args, kws)
        finally:
            _work.asked = None

    def get_compile_result(self, sig: Any) -> Any:
        """Called where the function's address is wanted, which a part has not."""
        if tuple(sig.args) in self._parts:
            self._function.compile(sig)
        return self._usual["get_compile_result"](sig)

    def compile(self, sig: Any) -> Any:
        """Called by numba where code for these arguments is needed."""
        from numba.core import compiler_lock, sigutils

        lock: Any = compiler_lock.global_compiler_lock
        normalised: Any = sigutils.normalize_signature  # carries no types
        with lock:
            part = bool(_work.parts) and _work.asked is self._function
            _work.asked = None
            arguments = tuple(normalised(sig)[0])
            overloads = self._function.overloads
            if part and arguments in overloads:
                return overloads[arguments].entry_point
            # a part that Python calls now is compiled for that, too
            before = None if part else self._parts.pop(arguments, None)
            if before is not None:
                self._alive.append(before)
                overloads.pop(arguments, None)
            try:
                return self._compile(sig, part)
            finally:
                if before is not None and arguments not in overloads:  # it failed
                    overloads[arguments] = self._parts[arguments] = before

    def _compile(self, sig: Any, part: bool) -> Any:
        compiler, owner = self._function._compiler, self._owner
        found = owner._cache, compiler.pipeline_class
        owner._cache, compiler.pipeline_class = self._caches[part], self._pipelines[part]
        _work.parts.append(part)
        try:
            return self._usual["compile"](sig)
        finally:
            _work.parts.pop()
            owner._cache, compiler.pipeline_class = found

    def add_overload(self, cres: Any) -> None:
        """Called by numba with what it compiled or loaded: a part is not shown to Python."""
        if _work.parts and _work.parts[-1]:
            arguments = tuple(cres.signature.args)
            self._function.overloads[arguments] = self._parts[arguments] = cres
        else:
            self._alive.extend(_set_environments(cres))
            self._usual["add_overload"](cres)

    def _compile_part(self, *given: Any) -> Any:
        """numba's compiler of a part, whose code goes where it is only kept, without wrappers."""
        from numba.core import compiler

        types, target, _, arguments, result, flags, names = given
        library = _library_of_parts()(target.codegen(), self._function.py_func.__qualname__)
        library.enable_object_caching()
        flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        make: Any = compiler.Compiler  # carries no types
        return make(types, target, library, arguments, result, flags, names)


def _set_environments(program: Any) -> list[Any]:
    """Where the parts of a program find what they raise, which each sets by itself otherwise."""
    from numba.core import environment

    codegen, found = program.library.codegen, []
    named: Any = environment.lookup_environment  # carries no types
    for each in program.library._final_module.global_variables:
        known = named(each.name)
        if known is not None and codegen._engine.get_global_value_address(each.name):
            codegen.set_env(each.name, known)
            found.append(known)
    return found


def _cache_of_parts(usual: Any) -> Any:
    """Parts lie in files of their own on disk, where nobody finds them who wants a program."""
    from numba.core import caching

    if not vars(usual):  # none is kept
        return usual
    load = usual._impl.rebuild

    def rebuild(target_context: Any, payload: Any) -> Any:
        codegen = target_context.codegen()
        before = codegen._library_class
        codegen._library_class = _library_of_parts()
        try:
            return load(target_context, payload)
        finally:
            codegen._library_class = before

    cache, impl = copy.copy(usual), copy.copy(usual._impl)
    impl.rebuild = rebuild
    file: Any = caching.IndexDataCacheFile  # carries no types
    cache._impl = impl
    cache._cache_file = file(
        cache_path=usual.cache_path,
        filename_base=f"{impl.filename_base}.part",
        source_stamp=impl.locator.get_source_stamp(),
    )
    return cache


@functools.cache
def _library_of_parts() -> Any:
    """The class; made when it is needed, since a numba that is not usable may have no such base."""
    from numba.core.codegen import JITCodeLibrary, RuntimeLinker

    class Elsewhere:
        """What runs a program: not this code, so it has no place for what it raises."""

        def __init__(self, codegen: Any) -> None:
            self._codegen = codegen

        def __getattr__(self, name: str) -> Any:
            return getattr(self._codegen, name)

        def set_env(self, env_name: str, env: Any) -> None:
            """The program does that."""

    class Library(JITCodeLibrary):
        """The code of a part: only what others can take in."""

        def _runs(self) -> bool:
            # functions that call each other in a circle are found by their address
            names = [each.name for each in self._final_module.global_variables]
            return any(name.startswith(RuntimeLinker.PREFIX) for name in names)

        @property
        def codegen(self) -> Any:
            return self._codegen if self._runs() else Elsewhere(self._codegen)

        def _optimize_final_module(self) -> None:
            base: Any = super()  # carries no types
            if self._runs():
                base._optimize_final_module()

        def _finalize_final_module(self) -> None:
            base: Any = super()
            if self._runs():
                base._finalize_final_module()
                return
            base._finalize_dynamic_globals()
            self._finalized = True

        def serialize_using_object_code(self) -> Any:
            """A part has no object code."""
            base: Any = super()
            return base.serialize_using_bitcode()

    return Library
