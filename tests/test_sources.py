"""What machine code is made of, found by reading: in packages of a few lines, and in this one."""

import importlib
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from eps_hil import machine_code
from eps_hil.sources import Sources

PACKAGE = Path(machine_code.__file__).parent
LAW = "LEVEL = 2.0\n\ndef law(x):\n    return LEVEL * x\n"


def behind(name: str = "f", **modules: str) -> set[str]:
    """Modules behind ``a.f`` in a package ``p``; ``deep__c`` stands for ``deep/c.py``."""
    texts = {f"{path.replace('__', '/')}.py": text.encode() for path, text in modules.items()}
    texts |= {"__init__.py": b"", "deep/__init__.py": b"", "compiled.py": b"def kernel(f): ..."}
    paths = Sources(texts, "p", "1").behind("a.py", name)
    return {path.removesuffix(".py") for path in paths if not path.endswith("__init__.py")}


@pytest.mark.parametrize(
    "text",
    [
        "from p.b import law\n\ndef f(x):\n    return law(x)\n",
        "from p.b import law as other\n\ndef f(x):\n    return other(x)\n",
        "from p import b\n\ndef f(x):\n    return b.law(x)\n",
        "import p.b\n\ndef f(x):\n    return p.b.law(x)\n",
        "import p.b as b\n\ndef f(x):\n    return b.law(x)\n",
        "from .b import law\n\ndef f(x):\n    return law(x)\n",
        "from . import b\n\ndef f(x):\n    return b.law(x)\n",
        "from p.b import *\n\ndef f(x):\n    return law(x)\n",
        "from p.b import LEVEL\n\ndef f(x):\n    return LEVEL * x\n",
        "from p.b import LEVEL\n\nTWICE = 2.0 * LEVEL\n\ndef f(x):\n    return TWICE * x\n",
        "from p import b\n\nother = b\n\ndef f(x):\n    return other.law(x)\n",
        "def made():\n    from p.b import law\n    return law\n\nlaw = made()\n\ndef f(x):\n"
        "    return law(x)\n",
        "from p.b import law\n\ndef f(x, g=law):\n    return g(x)\n",
        "from p.b import law\n\nclass f:\n    g = law\n",
        "from p.b import law\n\ndef wrap(g):\n    return g\n\n@wrap\ndef f(x):\n"
        "    return law(x)\n",
        "try:\n    from p.b import law\nexcept ImportError:\n    law = None\n\ndef f(x):\n"
        "    return law(x)\n",
        "from p.b import law\n\ndef f(law):\n    return law\n\nf = f(law)\n",
        "from p.b import law\n\ndef f(x):\n    return [law for law in law(x)]\n",
        "from p.b import law\n\ndef g(h):\n    def inner(x):\n        return h(x)\n"
        "    return inner\n\nf = g(law)\n",
        "from p.b import law\n\nTABLE = {}\nTABLE['law'] = law\n\ndef f(x):\n    return TABLE\n",
        "from p.b import law\n\nTABLE = []\nfor one in (law,):\n    TABLE.append(one)\n\n"
        "def f(x):\n    return TABLE\n",
        "from p.b import law\n\nif law:\n    def f(x):\n        return x\n",
    ],
)
def test_a_name_leads_to_what_binds_it(text: str) -> None:
    assert behind(a=text, b=LAW, c=LAW) == {"a", "b"}


@pytest.mark.parametrize(
    "text",
    [
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from p.b import law\n\n"
        "def f(x: 'law'):\n    return x\n",
        "from p.b import law\n\ndef f(x: law) -> law:\n    y: law = x\n    return y\n",
        "from p.b import law\n\ndef f(law):\n    return law(1.0)\n",
        "from p.b import law\n\ndef f(x):\n    law = x\n    return lambda y: law * y\n",
        "from p.b import law\n\ndef other(x):\n    return law(x)\n\ndef f(x):\n    return x\n",
        "from p.compiled import kernel\nfrom p.b import law\n\n@kernel\ndef other(x):\n"
        "    return law(x)\n\ndef f(x):\n    return x\n",
    ],
)
def test_nothing_else_counts(text: str) -> None:
    assert "b" not in behind(a=text, b=LAW)


def test_two_imports_away() -> None:
    a = "from p.b import twice\n\ndef f(x):\n    return twice(x)\n"
    b = "from p.deep.c import law\n\ndef twice(x):\n    return 2.0 * law(x)\n"
    assert behind(a=a, b=b, deep__c=LAW, d=LAW) == {"a", "b", "deep/c"}


def test_what_a_package_passes_on() -> None:
    a = "from p.deep import law\n\ndef f(x):\n    return law(x)\n"
    texts = {"a.py": a, "deep/__init__.py": "from p.deep.c import law\n", "deep/c.py": LAW}
    sources = Sources({path: text.encode() for path, text in texts.items()}, "p", "1")
    assert sources.behind("a.py", "f") == {"a.py", "deep/__init__.py", "deep/c.py"}


def test_what_is_registered_on_import_counts_for_all_who_import_it() -> None:
    a = "from p.b import g\n\ndef f(x):\n    return g(x)\n"
    b = "import p.c\n\ndef g(x):\n    return x\n"
    c = "from numba.extending import overload\nfrom p.d import law\n\n@overload(len)\ndef _(x):\n"
    c += "    return law\n"
    assert behind(a=a, b=b, c=c, d=LAW, e=LAW) == {"a", "b", "c", "d"}
    harmless = c.replace("from numba.extending import overload", "from functools import partial")
    assert behind(a=a, b=b, c=harmless.replace("overload", "partial"), d=LAW) == {"a", "b"}


@pytest.mark.parametrize(
    "text",
    [
        "import importlib\n\nb = importlib.import_module('p.' + 'b')\n\ndef f(x):\n"
        "    return b.law(x)\n",
        "from importlib import import_module as get\n\ndef f(x):\n    return get('p.b')\n",
        "import sys\n\ndef f(x):\n    return sys.modules['p.b'].law(x)\n",
        "def f(x):\n    return eval('p.b.law')(x)\n",
        "from p import deep\n\ndef f(x):\n    return deep.law(x)\n",
    ],
)
def test_names_worked_out_at_run_time_may_mean_anything(text: str) -> None:
    lazy = "def __getattr__(name):\n    return None\n"
    texts = {"a.py": text, "b.py": LAW, "unrelated.py": LAW, "deep/__init__.py": lazy}
    sources = Sources({path: one.encode() for path, one in texts.items()}, "p", "1")
    assert sources.behind("a.py", "f") == set(texts)
    assert sources.read == set(texts)


def test_a_digest_changes_with_what_is_behind_it_and_with_nothing_else() -> None:
    a = "from p.compiled import kernel\nfrom p.b import LEVEL\n\n"
    a += "@kernel\ndef f(x):\n    return LEVEL * x\n\n@kernel\ndef g(x):\n    return x\n"
    texts = {"a.py": a, "b.py": LAW, "c.py": LAW, "compiled.py": "def kernel(f): return f\n"}

    def found(version: str = "1", **other: str) -> Mapping[str, str]:
        changed = texts | {f"{name}.py": text for name, text in other.items()}
        sources = Sources({path: one.encode() for path, one in changed.items()}, "p", version)
        (rows,) = sources.statements(["a.py"]).values()
        return {row.names[0]: row.digest for row in rows}

    before = found()
    assert set(before) == {"f", "g"}
    assert before["f"] != before["g"]
    assert found(c="# other") == before
    constant = found(b=LAW.replace("2.0", "3.0"))
    assert (constant["f"] != before["f"], constant["g"]) == (True, before["g"])
    for everything in (found(a=a + "# end\n"), found(compiled="def kernel(f): 1\n"), found("2")):
        assert not set(everything.values()) & set(before.values())


@pytest.fixture(scope="module")
def sources() -> Sources:
    texts = {path: (PACKAGE / path).read_bytes() for path in machine_code._paths()}
    return Sources(texts, "eps_hil", "1")


def kernels() -> Iterator[tuple[str, str, Any]]:
    """Module's path, name and dispatcher of all compiled functions at the top level."""
    for path in machine_code._paths():
        if b"eps_hil.compiled import" in (PACKAGE / path).read_bytes():
            name = ".".join(["eps_hil", *path.removesuffix(".py").split("/")])
            for bound, value in vars(importlib.import_module(name)).items():
                if hasattr(value, "py_func") and value.py_func.__module__ == name:
                    yield path, bound, value


def codes(code: types.CodeType) -> Iterator[types.CodeType]:
    yield code
    for one in code.co_consts:
        if isinstance(one, types.CodeType):
            yield from codes(one)


def met(value: Any, seen: dict[int, Any]) -> Iterator[str]:
    """Modules that the objects come from which a function's code reaches while it runs."""
    value = getattr(value, "py_func", value)
    module = getattr(value, "__module__", None)
    if id(value) in seen or not isinstance(module, str) or not module.startswith("eps_hil."):
        return
    seen[id(value)] = value
    yield module
    if not isinstance(value, types.FunctionType):
        return
    names = {name for code in codes(value.__code__) for name in code.co_names}
    reached = [value.__globals__[name] for name in names if name in value.__globals__]
    reached += [cell.cell_contents for cell in value.__closure__ or ()]
    for one in reached:
        if isinstance(one, types.ModuleType):
            for name in names:
                yield from met(getattr(one, name, None), seen)
        else:
            yield from met(one, seen)


def test_all_that_a_kernel_reaches_is_among_its_sources(sources: Sources) -> None:
    """Against the objects that are there when the package is imported, not its text."""
    most = 0
    for path, name, kernel in kernels():
        reached = {one.replace(".", "/") + ".py" for one in set(met(kernel, {}))}
        found = {f"eps_hil/{one}" for one in sources.behind(path, name)}
        assert reached <= found, f"{path}: {name}"
        most = max(most, len(reached))
    assert most > 30  # the effects, the bristle, the estimator's step


def test_every_kernel_has_a_digest_of_its_own_sources() -> None:
    seen = 0
    for path, name, kernel in kernels():
        line = kernel.py_func.__code__.co_firstlineno
        assert machine_code._digest_of(path, line) != machine_code._whole(), f"{path}: {name}"
        seen += 1
    assert seen > 200


def test_diagnosis_and_estimator_do_not_hang_on_each_other(sources: Sources) -> None:
    run = sources.behind("estimation/stream_steps.py", "run")
    assert {"estimation/step.py", "physics/friction.py", "physics/effects/stribeck.py"} <= run
    assert not [path for path in run if path.startswith(("diagnosis", "rig", "service"))]
    probe = sources.behind("diagnosis/balance/problem.py", "_since_reversal")
    assert not [path for path in probe if path.startswith(("estimation", "physics"))]


def test_only_the_catalogue_finds_modules_by_name() -> None:
    """In a folder of its own, which is what ``sources`` takes for granted."""
    text = (PACKAGE / "physics/effects/catalogue.py").read_text(encoding="utf-8")
    assert text.count("import_module(") == 1
    assert 'import_module(f"{effects.__name__}.{name}")' in text
