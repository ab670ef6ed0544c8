"""Which sources of a package the machine code of a function is made of: read, not run.

Machine code holds what the function calls and every constant that it reads, code and numbers of
other modules too, as they were when it was compiled. From each top-level statement this follows
the names that it uses, through the imports of the package, to the statements that bind them. Every
module met on the way counts, the whole of its text. Beside names:

* a statement that does something when its module is imported (registers an overload, fills a
  table) counts for every module that imports its own, directly or not;
* code that finds modules by names worked out at run time counts as the whole package, but for
  ``_BY_NAME``;
* annotations do not count: numba does not read them. The records of an argument are part of its
  type.
"""

import ast
import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple

_BY_NAME: Mapping[str, str] = {"physics.effects.catalogue": "physics.effects"}
"""Modules that import by names worked out at run time, and the package that all of them lie in."""
_HARMLESS = ("functools", "dataclasses", "contextlib", "typing", "enum", "abc", "pydantic")
"""Modules whose decorators do nothing but to what they decorate; so do those of ``compiled``."""
_FINDERS = ("importlib", "pkgutil", "runpy", "sys.modules")
_INTERPRETERS = ("__import__", "exec", "eval", "globals", "vars")

Chain = tuple[str, ...]
"""A dotted name: ``added.level_nm``."""
Node = tuple[str, str, int]
"""What is done, module, and which statement of it."""
_ALL: Node = ("everything", "", 0)
_Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
_COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


class Statement(NamedTuple):
    """Lines of a top-level statement, names that it binds, digest of all that it is made of."""

    first: int
    last: int
    names: tuple[str, ...]
    digest: str


@dataclass(slots=True)
class _Read:
    """A top-level statement as read."""

    first: int
    last: int
    binds: set[str] = field(default_factory=set)
    uses: set[Chain] = field(default_factory=set)
    imports: list[tuple[str, str | None]] = field(default_factory=list)
    """In functions: module and name in it."""
    computes: bool = False
    """It calls something to bind its names."""
    acts: bool = False
    """It does something else when it is run."""


class _Module:
    """A module's statements, and what its names mean."""

    def __init__(self, name: str, text: bytes, is_package: bool, package: str) -> None:
        self.name, self._package = name, package
        self._home = name if is_package else name.rpartition(".")[0]
        self.statements: list[_Read] = []
        self.bound: dict[str, list[int]] = {}
        self.imports: dict[str, list[tuple[str, str | None]]] = {}
        self.star: list[str] = []
        self._decorated: set[int] = set()
        for node in ast.parse(text).body:
            self._read(node)
        self.answers_any = "__getattr__" in self.bound

    def _read(self, node: ast.stmt) -> None:
        if isinstance(node, ast.Import | ast.ImportFrom):
            self._bind_imports(node)
            return
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            return
        if isinstance(node, ast.If) and _name(node.test)[-1:] == ("TYPE_CHECKING",):
            for inside in node.orelse:
                self._read(inside)
            return
        decorators = getattr(node, "decorator_list", [])
        first = min([node.lineno, *(one.lineno for one in decorators)])
        read = _Read(first, node.end_lineno or node.lineno)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            read.binds.add(node.name)
            read.acts = any(not self._is_harmless(one) for one in decorators)
            if decorators:
                self._decorated.add(len(self.statements))
        elif isinstance(node, ast.Assign | ast.AnnAssign) and _plain(node):
            read.computes = node.value is not None and _calls(node.value)
        else:
            read.acts = True
        self._walk(node, read, None)
        for name in read.binds:
            self.bound.setdefault(name, []).append(len(self.statements))
        self.statements.append(read)

    def _walk(self, node: ast.AST, read: _Read, local: frozenset[str] | None) -> None:
        """Names that the code beneath a node uses; of code in no function, also those bound.

        ``local``: names of the functions around it, which are not the module's; None: in none.
        """
        if isinstance(node, ast.Import | ast.ImportFrom):
            if local is None:
                self._bind_imports(node)
            else:
                read.imports += [target for _, target in self._targets(node)]
        elif chain := _name(node):
            if chain[0] not in (local or ()):
                read.uses.add(chain)
            if local is None and isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                read.binds.add(node.id)
        elif isinstance(node, _FUNCTIONS):
            self._walk_function(node, read, local)
        elif isinstance(node, _COMPREHENSIONS):
            inside = (local or frozenset()).union(*map(_bound, node.generators))
            for loop in node.generators:
                self._walk(loop.iter, read, local or frozenset())
                self._walk_all(loop.ifs, read, inside)
            results = (node.key, node.value) if isinstance(node, ast.DictComp) else (node.elt,)
            self._walk_all(results, read, inside)
        else:
            self._walk_parts(node, read, local)

    def _walk_parts(self, node: ast.AST, read: _Read, local: frozenset[str] | None) -> None:
        if isinstance(node, ast.ClassDef) and local is None:
            read.binds.add(node.name)
            local = frozenset()
        elif isinstance(node, ast.Global):
            read.acts = True
        for name, value in ast.iter_fields(node):
            if name != "annotation":
                self._walk_all(value if isinstance(value, list) else [value], read, local)

    def _walk_all(self, nodes: Iterable[Any], read: _Read, local: frozenset[str] | None) -> None:
        for node in nodes:
            if isinstance(node, ast.AST):
                self._walk(node, read, local)

    def _walk_function(self, node: _Function, read: _Read, local: frozenset[str] | None) -> None:
        if local is None and not isinstance(node, ast.Lambda):
            read.binds.add(node.name)
        around = local or frozenset()
        self._walk_all([*getattr(node, "decorator_list", ()), *_defaults(node)], read, around)
        body = node.body if isinstance(node.body, list) else [node.body]
        self._walk_all(body, read, around | _locals(node))

    def compiling(self, compiler: str) -> list[int]:
        """Places of the statements that use ``compiler``, or what does for them."""
        using = {
            name
            for name, targets in self.imports.items()
            if any(source == compiler for source, _ in targets)
        }
        found: set[int] = set()
        while True:
            more = {
                place
                for place, one in enumerate(self.statements)
                if place not in found and any(chain[0] in using for chain in one.uses)
            }
            if not more:
                return sorted(found)
            found |= more
            for place in more - self._decorated:
                using |= self.statements[place].binds

    def _bind_imports(self, node: ast.Import | ast.ImportFrom) -> None:
        for name, target in self._targets(node):
            if name == "*":
                self.star.append(target[0])
            else:
                self.imports.setdefault(name, []).append(target)

    def _targets(
        self, node: ast.Import | ast.ImportFrom
    ) -> Iterator[tuple[str, tuple[str, str | None]]]:
        if isinstance(node, ast.Import):
            for one in node.names:
                if one.asname:
                    yield one.asname, (one.name, None)
                else:
                    yield one.name.partition(".")[0], (one.name.partition(".")[0], None)
                    yield "", (one.name, None)  # imported, whatever it is called
            return
        source = node.module or ""
        if node.level:
            parts = self._home.split(".")
            source = ".".join([*parts[: len(parts) - node.level + 1], *filter(None, [source])])
        for one in node.names:
            yield one.asname or one.name, (source, None if one.name == "*" else one.name)

    def _is_harmless(self, decorator: ast.expr) -> bool:
        chain = _name(decorator.func if isinstance(decorator, ast.Call) else decorator)
        known = [*_HARMLESS, f"{self._package}.compiled"]
        return bool(chain) and any(
            module in known for module, _ in self.imports.get(chain[0], [("", None)])
        )


def _defaults(function: _Function) -> list[ast.expr]:
    given = function.args
    return [*given.defaults, *(one for one in given.kw_defaults if one is not None)]


def _locals(function: _Function) -> frozenset[str]:
    """Names that are a function's own; one too few only makes more count."""
    given = function.args
    found = {one.arg for one in (*given.posonlyargs, *given.args, *given.kwonlyargs)}
    found |= {one.arg for one in (given.vararg, given.kwarg) if one is not None}
    elsewhere: set[str] = set()
    waiting: list[ast.AST] = list(function.body) if isinstance(function.body, list) else []
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Global):
            elsewhere.update(node.names)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {(one.asname or one.name).partition(".")[0] for one in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        elif not isinstance(node, (*_COMPREHENSIONS, ast.Lambda)):
            waiting += ast.iter_child_nodes(node)
    return frozenset(found - elsewhere)


def _bound(loop: ast.comprehension) -> set[str]:
    return {one.id for one in ast.walk(loop.target) if isinstance(one, ast.Name)}


def _name(node: ast.AST) -> Chain:
    """The dotted name that an expression is; empty: another kind of expression."""
    if isinstance(node, ast.Name):
        return (node.id,)
    if isinstance(node, ast.Attribute):
        before = _name(node.value)
        return (*before, node.attr) if before else ()
    return ()


def _plain(node: ast.Assign | ast.AnnAssign) -> bool:
    """Whether only names are bound."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    parts = [
        part
        for target in targets
        for part in (target.elts if isinstance(target, ast.Tuple | ast.List) else [target])
    ]
    return all(isinstance(part, ast.Name) for part in parts)


def _calls(node: ast.AST) -> bool:
    return any(isinstance(one, ast.Call) for one in ast.walk(node))


class Sources:
    """The sources of one package: their texts by path within it (``physics/friction.py``)."""

    def __init__(self, texts: Mapping[str, bytes], package: str, version: str) -> None:
        self._package, self._version = package, version
        self._paths = {self._module_of(path): path for path in texts}
        self._texts = texts
        self._bits = {name: 1 << place for place, name in enumerate(sorted(self._paths))}
        self._everything = (1 << len(self._paths)) - 1
        self._edges: dict[Node, set[Node]] = {}
        self._own: dict[Node, int] = {}
        self._modules: dict[str, _Module] = {}

    def statements(self, wanted: Iterable[str]) -> dict[str, list[Statement]]:
        """Top-level statements in which functions are compiled, of the modules at these paths."""
        compiling = {
            name: self._module(name).compiling(f"{self._package}.compiled")
            for name in map(self._module_of, wanted)
        }
        for name, places in compiling.items():
            for place in places:
                self._follow(("statement", name, place))
        made_of = self._closed()
        digest = cache(self._digest)

        def described(name: str, place: int) -> Statement:
            one = self._module(name).statements[place]
            names = tuple(sorted(one.binds))
            return Statement(one.first, one.last, names, digest(made_of["statement", name, place]))

        return {
            self._paths[name]: [described(name, place) for place in places]
            for name, places in compiling.items()
        }

    def behind(self, path: str, name: str) -> set[str]:
        """Paths of all that a name at the top level of a module is made of."""
        module = self._module_of(path)
        wanted: list[Node] = [("statement", module, k) for k in self._module(module).bound[name]]
        for node in wanted:
            self._follow(node)
        made_of = self._closed()
        return {
            self._paths[one]
            for one, bit in self._bits.items()
            if any(made_of[node] & bit for node in wanted)
        }

    @property
    def read(self) -> set[str]:
        """Paths of the sources that were looked into."""
        if any(_ALL in edges for edges in self._edges.values()):
            return set(self._texts)
        return {self._paths[name] for name in self._modules}

    def _module_of(self, path: str) -> str:
        parts = [self._package, *path.removesuffix(".py").split("/")]
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)

    def _module(self, name: str) -> _Module:
        if name not in self._modules:
            path = self._paths[name]
            self._modules[name] = _Module(
                name, self._texts[path], path.endswith("__init__.py"), self._package
            )
        return self._modules[name]

    def _follow(self, start: Node) -> None:
        """Fill in what ``start`` needs, and what that needs."""
        waiting = [start]
        while waiting:
            node = waiting.pop()
            if node in self._edges:
                continue
            self._own[node], edges = self._needs(node)
            self._edges[node] = edges
            waiting += edges

    def _needs(self, node: Node) -> tuple[int, set[Node]]:
        """What a node counts itself (a bit a module), and the nodes that it needs."""
        what, name, place = node
        if node == _ALL:
            return self._everything, set()
        if what == "acts":
            return self._acts(name)
        module = self._module(name)
        if what == "met":  # a name of it is used
            computed = {
                ("statement", name, place)
                for place, one in enumerate(module.statements)
                if one.computes
            }
            return self._bits[name], {("acts", name, 0), *computed}
        if what == "all":
            needed: set[Node] = {("met", name, 0)}
            needed |= {("statement", name, k) for k in range(len(module.statements))}
            for targets in module.imports.values():
                for target in targets:
                    needed |= self._imported(target, ())
            for star in module.star:
                needed |= self._inside(star, ())
            return 0, needed
        read = module.statements[place]
        needed = {("met", name, 0)}
        for chain in read.uses:
            needed |= self._used(module, chain)
        for target in read.imports:
            needed |= self._by_name(module, target[0]) | self._imported(target, ())
        return 0, needed

    def _acts(self, name: str) -> tuple[int, set[Node]]:
        """What importing a module does beside binding names; so do its own imports."""
        module = self._module(name)
        acting = {
            ("statement", name, place) for place, one in enumerate(module.statements) if one.acts
        }
        needed: set[Node] = set(acting)
        for targets in module.imports.values():
            for source, inside in targets:
                for one in (source, f"{source}.{inside}"):
                    needed |= {("acts", up, 0) for up in _with_parents(one) if up in self._paths}
        for star in module.star:
            needed |= {("acts", up, 0) for up in _with_parents(star) if up in self._paths}
        needed |= {("acts", up, 0) for up in _with_parents(name) if up in self._paths}
        return 0, needed

    def _used(self, module: _Module, chain: Chain) -> set[Node]:
        """What a dotted name in a module's own code is made of."""
        name, rest = chain[0], chain[1:]
        needed: set[Node] = {("statement", module.name, k) for k in module.bound.get(name, ())}
        for target in module.imports.get(name, ()):
            needed |= self._by_name(module, ".".join([target[0], *rest]))
            needed |= self._imported(target, rest)
        if name in module.bound or name in module.imports:
            return needed
        if name in _INTERPRETERS:
            return self._anything(module)
        for star in module.star:
            needed |= self._inside(star, chain)
        return needed

    def _by_name(self, module: _Module, source: str) -> set[Node]:
        if not any(source == one or source.startswith(f"{one}.") for one in _FINDERS):
            return set()
        return self._anything(module)

    def _anything(self, module: _Module) -> set[Node]:
        """What a module may mean that finds others by names worked out at run time."""
        folder = _BY_NAME.get(module.name.removeprefix(f"{self._package}."))
        if folder is None:
            return {_ALL}
        below = f"{self._package}.{folder}."
        return {("all", name, 0) for name in self._paths if name.startswith(below)}

    def _imported(self, target: tuple[str, str | None], rest: Chain) -> set[Node]:
        source, name = target
        return self._inside(source, (*filter(None, [name]), *rest))

    def _inside(self, source: str, chain: Chain) -> set[Node]:
        """What ``source.chain`` is made of, seen from outside of the module."""
        if source not in self._paths:  # a folder without __init__.py, or another's package
            below = ".".join([source, *chain[:1]])
            if not chain or not any(f"{name}.".startswith(f"{below}.") for name in self._paths):
                return {("all", name, 0) for name in self._paths if name.startswith(f"{source}.")}
            return self._inside(below, chain[1:])
        if not chain:
            return {("all", source, 0)}
        module, name = self._module(source), chain[0]
        needed: set[Node] = {("met", source, 0)}
        known = name in module.bound or name in module.imports
        if known:
            needed |= self._used(module, chain)
        below = f"{source}.{name}"
        if below in self._paths:
            needed |= self._inside(below, chain[1:])
        elif not known:
            for star in module.star:
                needed |= self._inside(star, chain)
            if module.answers_any:
                needed.add(_ALL)
        return needed

    def _closed(self) -> dict[Node, int]:
        """All that each node is made of: a bit a module."""
        found = dict(self._own)
        order = list(reversed(self._edges))  # mostly from the leaves
        changed = True
        while changed:
            changed = False
            for node in order:
                mask = found[node]
                for one in self._edges[node]:
                    mask |= found[one]
                if mask != found[node]:
                    found[node], changed = mask, True
        return found

    def _digest(self, mask: int) -> str:
        digest = hashlib.sha256(self._version.encode())
        for name, bit in self._bits.items():
            if mask & bit:
                text = self._texts[self._paths[name]]
                digest.update(f"\0{self._paths[name]}\0{len(text)}\0".encode() + text)
        return digest.hexdigest()[:16]


def _with_parents(module: str) -> list[str]:
    parts = module.split(".")
    return [".".join(parts[:k]) for k in range(1, len(parts) + 1)]
