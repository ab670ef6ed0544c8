"""Kernels compiled as a part of another one, and what becomes of them when Python calls."""

import importlib
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

import numba
import numpy as np
import numpy.typing as npt
import pytest
from numba import types
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.errors import TypingError

from eps_hil import within
from eps_hil.compiled import kernel, njit

Kernel = Callable[..., Any]


@kernel
def root(value: float) -> float:
    if value < 0.0:
        raise ValueError("below zero")
    return np.sqrt(value)


@kernel
def sum_of_roots(values: npt.NDArray[np.float64]) -> float:
    total = 0.0
    for value in values:
        total += root(value)
    return total


@njit
def roots(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    found = np.empty_like(values)
    for row in range(len(values)):
        found[row] = root(values[row]) + 0.0 * sum_of_roots(values)
    return found


def is_part(function: object) -> bool:
    (program,) = function.overloads.values()  # type: ignore[attr-defined]
    return isinstance(program.library, within._library_of_parts())


def uncached(*functions: Kernel) -> list[Any]:
    """As a kernel that is kept nowhere."""
    made = [numba.njit(nogil=True)(function) for function in functions]
    for each in made:
        within.only_part(each)
    return made


def test_a_part_is_a_program_of_its_own_when_python_calls_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Compiled here: of kept code a part is none until somebody calls it."""
    monkeypatch.setattr(FunctionCache, "load_overload", lambda *_: None)
    values = np.array([4.0, 9.0])
    assert np.array_equal(roots(values), [2.0, 3.0])
    assert [is_part(one) for one in (root, sum_of_roots, roots)] == [True, True, False]
    assert sum_of_roots(values) == 5.0
    assert [is_part(one) for one in (root, sum_of_roots, roots)] == [True, False, False]
    assert root(16.0) == 4.0
    assert not is_part(root)
    assert roots(values).sum() == sum_of_roots(values) == 5.0


def test_what_a_part_raises_arrives() -> None:
    for function in (sum_of_roots, roots):
        with pytest.raises(ValueError, match="below zero"):
            function(np.array([-1.0]))
    with pytest.raises(ValueError, match="below zero"):
        root(-1.0)


@pytest.mark.parametrize("saved", [0, 1], ids=["the part", "the program"])
def test_what_cannot_be_kept_on_disk_still_raises_and_is_run_as_a_program(
    monkeypatch: pytest.MonkeyPatch, saved: int
) -> None:
    @kernel
    def half(value: float) -> float:
        if value < 0.0:
            raise ValueError("less than nothing")
        return 0.5 * value

    @kernel
    def quarter(value: float) -> float:
        return half(half(value))

    calls: list[object] = []

    def full(*call: object) -> None:
        calls.append(call)
        if len(calls) > saved:
            raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(FunctionCache, "load_overload", lambda *_: None)
        patch.setattr(FunctionCache, "save_overload", full)
        with pytest.raises(OSError, match="No space left"):
            quarter(8.0)
    assert is_part(half)
    with pytest.raises(ValueError, match="less than nothing"):
        quarter(-8.0)
    assert quarter(8.0) == 2.0
    assert half(8.0) == 4.0
    assert not is_part(half)


def test_what_cannot_be_compiled_leaves_nothing_behind() -> None:
    def twice(value: float) -> float:
        return 2.0 * value

    def wrong(value: float) -> float:
        return part(value) + value.nothing  # type: ignore[attr-defined]

    def right(value: float) -> float:
        return part(value) + part(value)

    part, bad, good = uncached(twice, wrong, right)
    for _ in range(2):
        with pytest.raises(TypingError):
            bad(1.0)
        assert within._work.parts == []
        assert within._work.asked is None
    assert good(1.0) == 4.0
    assert is_part(part)
    assert part(1.0) == 2.0
    assert not is_part(part)


def test_functions_that_call_each_other_in_a_circle() -> None:
    def even(count: int) -> bool:
        return True if count == 0 else odds(count - 1)

    def odd(count: int) -> bool:
        if count < 0:
            raise ValueError("never ends")
        return False if count == 0 else evens(count - 1)

    def parity(count: int) -> int:
        return 7 if evens(count) else 8

    evens, odds, parities = uncached(even, odd, parity)
    assert [parities(10), parities(11)] == [7, 8]
    with pytest.raises(ValueError, match="never ends"):
        parities(-1)
    assert evens(4)
    assert not odds(4)


def part_of_a_ninth() -> Kernel:
    """A third, compiled as a part of a kernel that calls it twice."""

    def third(value: float) -> float:
        if value < 0.0:
            raise ValueError("less than nothing")
        return value / 3.0

    def ninth(value: float) -> float:
        return part(part(value))

    part, whole = uncached(third, ninth)
    assert whole(9.0) == 1.0
    return part


def test_a_part_whose_address_is_wanted_is_a_program() -> None:
    part = part_of_a_ninth()
    assert is_part(part)
    kind = types.FunctionType(types.float64(types.float64))

    @numba.njit(types.float64(kind, types.float64))
    def applied(function: Kernel, value: float) -> float:
        return function(value) + 1.0

    assert applied(part, 9.0) == 4.0
    assert not is_part(part)


def test_a_part_in_a_kernel_of_somebody_else() -> None:
    part = part_of_a_ninth()

    @numba.njit(parallel=True)
    def thirds(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        found = np.empty_like(values)
        for row in numba.prange(len(values)):
            found[row] = part(values[row])
        return found

    assert np.array_equal(thirds(np.array([3.0, 6.0])), [1.0, 2.0])
    assert not is_part(part)


def test_threads_that_want_the_same_kernels_at_once() -> None:
    def third(value: float) -> float:
        if value < 0.0:
            raise ValueError("less than nothing")
        return value / 3.0

    def ninth(value: float) -> float:
        return part(part(value))

    def sixth(value: float) -> float:
        return 0.5 * part(value)

    part, one, other = uncached(third, ninth, sixth)
    begin, found = threading.Barrier(3), {}

    def work(function: Kernel, value: float) -> None:
        begin.wait()
        found[function] = function(value)

    threads = [
        threading.Thread(target=work, args=each) for each in ((one, 9.0), (other, 6.0), (part, 3.0))
    ]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert [found.get(each) for each in (one, other, part)] == [1.0, 1.0, 1.0]
    assert not is_part(part)
    for each in (one, other, part):
        with pytest.raises(ValueError, match="less than nothing"):
            each(-1.0)


@pytest.fixture
def asked_anew() -> Iterator[None]:
    """``usable`` forgets what it has found."""
    within.usable.cache_clear()
    yield
    within.usable.cache_clear()


def without(name: str, patch: pytest.MonkeyPatch) -> None:
    """Take a name in ``numba.core`` away from where it is defined."""
    module, *path, last = name.split(".")
    owner = importlib.import_module(f"numba.core.{module}")
    for each in path:
        owner = getattr(owner, each)
    places = [each for each in getattr(owner, "__mro__", [owner]) if each is not object]
    found = [place for place in places if last in vars(place)]
    assert found, f"{name} is not there"
    for place in found:
        patch.delattr(place, last)


def compiled_as_always() -> bool:
    """Whether numba compiles every function by itself, with the usual results."""
    whole, part = kernel(sum_of_roots.py_func), kernel(root.py_func)  # type: ignore[attr-defined]
    values = np.array([2.0, 3.0])
    assert (whole(values), part(2.0)) == (float(np.sqrt(2.0) + np.sqrt(3.0)), float(np.sqrt(2.0)))
    with pytest.raises(ValueError, match="below zero"):
        whole(-values)
    (program,) = whole.overloads.values()
    return type(program.library) is JITCodeLibrary and "add_overload" not in vars(whole)


@pytest.mark.parametrize("name", list(within._RELIES_ON))
def test_numba_compiles_as_always_where_an_inner_part_is_gone(
    name: str, monkeypatch: pytest.MonkeyPatch, asked_anew: None
) -> None:
    with monkeypatch.context() as patch:
        without(name, patch)
        assert not within.usable()
    assert compiled_as_always()


def test_numba_compiles_as_always_where_an_inner_part_has_changed(
    monkeypatch: pytest.MonkeyPatch, asked_anew: None
) -> None:
    def set_env(self: object, env_name: str, env: object, more: object) -> NoReturn:
        raise AssertionError((self, env_name, env, more))

    with monkeypatch.context() as patch:
        patch.setattr(JITCPUCodegen, "set_env", set_env)
        assert not within.usable()
    assert compiled_as_always()


def test_numba_compiles_as_always_where_somebody_else_keeps_its_code(
    monkeypatch: pytest.MonkeyPatch, asked_anew: None
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(JITCPUCodegen, "_library_class", type("Theirs", (JITCodeLibrary,), {}))
        assert not within.usable()
    assert compiled_as_always()


@pytest.mark.parametrize("version", ["0.59.1", "0.69.0", "1.60.0", "0.69.0dev0+12.gabc", "unknown"])
def test_numba_compiles_as_always_in_a_version_that_was_not_tried(
    version: str, monkeypatch: pytest.MonkeyPatch, asked_anew: None
) -> None:
    monkeypatch.setattr(numba, "__version__", version)
    assert not within.usable()
    monkeypatch.undo()
    assert compiled_as_always()


@pytest.mark.parametrize("version", ["0.60.0", "0.61.2", "0.64.0", "0.67.0", "0.68.1", "0.68.2rc1"])
def test_versions_that_were_tried(
    version: str, monkeypatch: pytest.MonkeyPatch, asked_anew: None
) -> None:
    monkeypatch.setattr(numba, "__version__", version)
    assert within.usable()


PROGRAM = """
import json, sys
import numpy as np
from eps_hil import compiled, within

acts = within.usable()
if sys.argv[1] == "as always":  # in the same folder
    within.usable = lambda: False
sys.path.insert(0, sys.argv[2])
from kept import ninth, third

def raised(function):
    try:
        function(-1.0)
    except ValueError as error:
        return str(error)

found = [ninth(5.0).hex(), raised(ninth), third(5.0).hex(), raised(third), raised(ninth)]
misses = [sum(each.stats.cache_misses.values()) for each in (ninth, third)]
print(json.dumps({"acts": acts, "found": found, "misses": misses}))
"""
KEPT = """
from eps_hil.compiled import kernel

@kernel
def third(value):
    if value < 0.0:
        raise ValueError("less than nothing")
    return value / 3.0

@kernel
def ninth(value):
    return third(third(value))
"""


@pytest.mark.parametrize("first", [pytest.param("parts", marks=pytest.mark.slow), "as always"])
def test_processes_with_and_without_parts_share_a_folder(
    first: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "kept.py").write_text(KEPT)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    second = {"parts": "as always", "as always": "parts"}[first]

    def run(way: str) -> dict[str, Any]:
        program = [sys.executable, "-c", PROGRAM, way, str(tmp_path)]
        done = subprocess.run(program, capture_output=True, text=True, check=True)
        answer: dict[str, Any] = json.loads(done.stdout)
        assert answer["acts"]
        return answer

    answers = [run(way) for way in (first, first, second)]
    assert answers[0]["found"] == answers[1]["found"] == answers[2]["found"]
    assert answers[0]["found"][1] == "less than nothing"
    assert answers[0]["misses"] == ([1, 2] if first == "parts" else [1, 1])
    assert answers[1]["misses"] == answers[2]["misses"] == [0, 0]
