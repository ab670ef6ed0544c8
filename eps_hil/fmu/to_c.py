"""C from the compiled kernels: the subset of Python that they are written in, and no more.

A kernel works on numbers, tuples of named numbers and rows of numbers that it is given, without
allocating: nearly C already. Operations keep their order, so that a compiler without contraction
(``-ffp-contract=off``) computes what numba does. What is not in the subset is refused by name.
"""

import ast
import inspect
import math
import textwrap
import typing
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

Typed = tuple[str, Any]
"""C text and type: "double", "int", "double *", a NamedTuple class, or a tuple of types."""
_ROW = "double *"
_MATH = ("exp", "expm1", "sin", "cos", "tan", "tanh", "sqrt", "atan", "log", "log1p")
_FUNCTIONS: Mapping[Any, str] = {
    **{getattr(math, name): name for name in _MATH},
    math.copysign: "copysign",
    np.ceil: "ceil",
}
_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_COMPARE = {
    **{ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="},
}


class NotCarriedError(Exception):
    """A kernel holds what is not translated; the text says what and where."""


class Given(NamedTuple):
    """What stands in C already for a Python function: its name there and what it returns."""

    name: str
    returns: Any = "double"


class Translation:
    """C functions of kernels and of all that they call, in an order that a compiler takes."""

    def __init__(self, given: Mapping[Any, Given], opaque: Mapping[type, str]) -> None:
        self._given = {id(key): value for key, value in given.items()}
        self._opaque = dict(opaque)  # classes whose C struct somebody else writes
        self._names: dict[int, Given] = {}
        self._structs: dict[Any, str] = {}
        self.types: list[str] = []
        self.functions: list[str] = []

    def function(self, kernel: Callable[..., Any]) -> Given:
        """The C function of a kernel, translated now if it is not yet."""
        if id(kernel) in self._given:
            return self._given[id(kernel)]
        source: Any = getattr(kernel, "py_func", kernel)
        if not inspect.isfunction(source):
            raise NotCarriedError(f"'{getattr(kernel, '__name__', kernel)}'")
        if id(source) not in self._names:
            one = _Function(self, source)
            taken = {known.name for known in self._names.values()}
            name, number = one.name, 2
            while name in taken:
                name, number = f"{one.name}_{number}", number + 1
            self.functions.append(one.text(name))
            self._names[id(source)] = Given(name, one.returns)
        return self._names[id(source)]

    def c_type(self, kind: Any) -> str:
        """How C writes a type; a struct is written out where it is met first."""
        if isinstance(kind, str):
            return kind
        if kind in self._opaque:
            return self._opaque[kind]
        if kind not in self._structs:
            if isinstance(kind, tuple):
                name = "Tuple" + "".join("I" if one == "int" else "D" for one in kind)
                fields = [(f"v{k}", one) for k, one in enumerate(kind)]
            else:
                name = kind.__name__
                fields = list(fields_of(kind).items())
            body = "".join(f"    {self.c_type(one)} {field};\n" for field, one in fields)
            self.types.append(f"typedef struct {{\n{body}}} {name};\n")
            self._structs[kind] = name
        return self._structs[kind]


def fields_of(kind: Any) -> dict[str, Any]:
    """Fields of a NamedTuple with their types in C."""
    return {name: c_kind(one) for name, one in typing.get_type_hints(kind).items()}


def c_kind(hint: Any) -> Any:
    """The type in C of a type hint of a kernel."""
    if hint is float:
        return "double"
    if hint is int or hint is bool:
        return "int"
    if hint is type(None):
        return "void"
    origin = typing.get_origin(hint)
    if origin is np.ndarray:
        return _ROW
    if origin is tuple:
        return tuple(c_kind(one) for one in typing.get_args(hint))
    if isinstance(hint, type) and issubclass(hint, tuple):
        return hint
    raise NotCarriedError(f"the type {hint}")


class _Function:
    """One kernel on its way to C."""

    def __init__(self, whole: Translation, function: Any) -> None:
        self._whole, self._globals = whole, function.__globals__
        place = f"{function.__module__}.{function.__name__}"
        self._place = place.removeprefix("eps_hil.physics.")
        self.name = f"{function.__module__.split('.')[-1]}_{function.__name__.lstrip('_')}"
        if function.__closure__:
            raise self._no("a closure")
        hints = typing.get_type_hints(function)
        self.returns = c_kind(hints.pop("return"))
        self._parameters = {name: c_kind(hint) for name, hint in hints.items()}
        self._locals: dict[str, Any] = {}
        self._lines: list[str] = []
        self._temporaries = 0
        tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        self._doc = (ast.get_docstring(tree) or "").split("\n")[0]
        self._body = tree.body

    def _no(self, what: str) -> NotCarriedError:
        return NotCarriedError(f"{what} in {self._place}")

    def text(self, name: str) -> str:
        c = self._whole.c_type
        self._block(self._body, 1)
        given = ", ".join(f"{c(kind)} {one}" for one, kind in self._parameters.items())
        own = "".join(f"    {c(kind)} {one};\n" for one, kind in self._locals.items())
        doc = f"/* {self._place}: {self._doc} */\n" if self._doc else f"/* {self._place} */\n"
        body = "\n".join(self._lines)
        return f"{doc}static {c(self.returns)} {name}({given})\n{{\n{own}{body}\n}}\n"

    def _say(self, line: str, depth: int) -> None:
        self._lines.append("    " * depth + line)

    def _block(self, body: list[ast.stmt], depth: int) -> None:
        for one in body:
            self._statement(one, depth)

    def _statement(self, one: ast.stmt, depth: int) -> None:  # noqa: PLR0912 (a table of them)
        match one:
            case ast.Expr(value=ast.Constant()):
                return
            case ast.Expr(value=ast.Call() as call):
                self._say(f"{self._expression(call)[0]};", depth)
            case ast.Return(value=None) | ast.Return(value=ast.Constant(value=None)):
                self._say("return;", depth)
            case ast.Return(value=ast.Tuple(elts=parts)):
                values = ", ".join(self._expression(part)[0] for part in parts)
                self._say(f"return ({self._whole.c_type(self.returns)}){{{values}}};", depth)
            case ast.Return(value=value):
                assert value is not None
                self._say(f"return {self._expression(value)[0]};", depth)
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=parts)):
                held = [self._held(self._expression(part), depth) for part in parts]
                for target, each in zip(targets, held, strict=True):
                    self._assign(target, each, depth)
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=value):
                name, kinds = self._held(self._expression(value), depth)
                for k, target in enumerate(targets):
                    self._assign(target, (f"{name}.v{k}", kinds[k]), depth)
            case ast.Assign(targets=[target], value=value):
                self._assign(target, self._expression(value), depth)
            case ast.AugAssign(target=target, op=op, value=value) if type(op) in _OPERATORS:
                whole = ast.BinOp(left=target, op=op, right=value)
                self._assign(target, self._expression(whole), depth)
            case ast.If(test=test, body=body, orelse=orelse):
                self._say(f"if ({self._expression(test)[0]}) {{", depth)
                self._block(body, depth + 1)
                if orelse:
                    self._say("} else {", depth)
                    self._block(orelse, depth + 1)
                self._say("}", depth)
            case ast.For(target=ast.Name(id=name), iter=ast.Call(args=ends) as call):
                if self._object(call.func) is not range or len(ends) > 2:
                    raise self._no("a loop over something else than a range")
                first, last = ["0", *(self._expression(end)[0] for end in ends)][-2:]
                self._locals.setdefault(name, "int")
                self._say(f"for ({name} = {first}; {name} < {last}; {name}++) {{", depth)
                self._block(one.body, depth + 1)
                self._say("}", depth)
            case ast.Continue():
                self._say("continue;", depth)
            case ast.Break():
                self._say("break;", depth)
            case _:
                raise self._no(type(one).__name__)

    def _held(self, value: Typed, depth: int) -> Typed:
        self._temporaries += 1
        name = f"held_{self._temporaries}"
        self._locals[name] = value[1]
        self._say(f"{name} = {value[0]};", depth)
        return name, value[1]

    def _assign(self, target: ast.expr, value: Typed, depth: int) -> None:
        if isinstance(target, ast.Name):
            if target.id not in self._parameters:
                known = self._locals.setdefault(target.id, value[1])
                if known == "int" and value[1] == "double":
                    raise self._no(f"'{target.id}', first an integer and then none,")
            self._say(f"{target.id} = {value[0]};", depth)
        elif isinstance(target, ast.Subscript):
            self._say(f"{self._expression(target)[0]} = {value[0]};", depth)
        else:
            raise self._no("an assignment to something else than a name or a number of a row")

    def _object(self, node: ast.expr) -> Any:
        """The Python object that a name outside the function stands for."""
        if isinstance(node, ast.Attribute):
            return getattr(self._object(node.value), node.attr)
        if isinstance(node, ast.Name):
            builtins = {one.__name__: one for one in (abs, min, max, int, float, range)}
            found = self._globals.get(node.id, builtins.get(node.id))
            if found is not None:
                return found
        raise self._no(f"'{ast.unparse(node)}'")

    def _expression(self, node: ast.expr) -> Typed:  # noqa: PLR0911, PLR0912 (a table of them)
        match node:
            case ast.Constant(value=bool() as value):
                return str(int(value)), "int"
            case ast.Constant(value=int() | float() as value):
                return _literal(value)
            case ast.Name(id=name) if name in self._parameters:
                return name, self._parameters[name]
            case ast.Name(id=name) if name in self._locals:
                return name, self._locals[name]
            case ast.Name():
                return self._constant(node)
            case ast.Attribute(value=value, attr=attr):
                if self._is_own(value):
                    text, kind = self._expression(value)
                    return f"{text}.{attr}", fields_of(kind)[attr]
                return self._constant(node)
            case ast.Subscript(value=value, slice=index):
                text, kind = self._expression(value)
                if kind != _ROW or isinstance(index, ast.Tuple | ast.Slice):
                    raise self._no("a part of something else than a row")
                return f"{text}[{self._expression(index)[0]}]", "double"
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                (a, kind_a), (b, kind_b) = self._expression(left), self._expression(right)
                kind = "int" if kind_a == kind_b == "int" else "double"
                if isinstance(op, ast.Div) and kind == "int":
                    a, kind = f"(double){a}", "double"
                return f"({a} {_OPERATORS[type(op)]} {b})", kind
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                text, kind = self._expression(operand)
                return f"(-{text})", kind
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return f"(!{self._expression(operand)[0]})", "int"
            case ast.BoolOp(op=op, values=values):
                joined = (" && " if isinstance(op, ast.And) else " || ").join(
                    self._expression(value)[0] for value in values
                )
                return f"({joined})", "int"
            case ast.IfExp(test=test, body=body, orelse=orelse):
                (a, kind_a), (b, kind_b) = self._expression(body), self._expression(orelse)
                kind = kind_a if kind_a == kind_b else "double"
                return f"({self._expression(test)[0]} ? {a} : {b})", kind
            case ast.Compare():
                return self._compare(node), "int"
            case ast.Call():
                return self._call(node)
        raise self._no(f"'{ast.unparse(node)}'")

    def _is_own(self, node: ast.expr) -> bool:
        while isinstance(node, ast.Attribute):
            node = node.value
        return isinstance(node, ast.Name) and (
            node.id in self._parameters or node.id in self._locals
        )

    def _constant(self, node: ast.expr) -> Typed:
        value = self._object(node)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._no(f"'{ast.unparse(node)}'")
        return _literal(value)

    def _compare(self, node: ast.Compare) -> str:
        sides = [node.left, *node.comparators]
        found = []
        for left, op, right in zip(sides, node.ops, sides[1:], strict=False):
            text = self._expression(left)[0]
            if isinstance(op, ast.In | ast.NotIn) and isinstance(right, ast.Tuple):
                each = " || ".join(f"{text} == {self._expression(one)[0]}" for one in right.elts)
                found.append(f"({each})" if isinstance(op, ast.In) else f"!({each})")
            elif type(op) in _COMPARE:
                found.append(f"{text} {_COMPARE[type(op)]} {self._expression(right)[0]}")
            else:
                raise self._no(f"'{ast.unparse(node)}'")
        return "(" + " && ".join(found) + ")"

    def _call(self, node: ast.Call) -> Typed:
        called = self._object(node.func)
        given = [self._expression(one) for one in node.args]
        text = ", ".join(one for one, _ in given)
        if node.keywords:
            raise self._no(f"'{ast.unparse(node)}'")
        if called is int or called is float:
            kind = "int" if called is int else "double"
            return f"(({kind}){given[0][0]})", kind
        if called is abs:
            kind = given[0][1]
            return f"{'abs' if kind == 'int' else 'fabs'}({text})", kind
        if called is min or called is max:
            whole = all(kind == "int" for _, kind in given)
            if len(given) != 2:
                raise self._no(f"'{ast.unparse(node)}'")
            name = "lesser" if called is min else "greater"
            return f"{name}{'_int' if whole else ''}({text})", "int" if whole else "double"
        if isinstance(called, type) and issubclass(called, tuple):
            return f"({self._whole.c_type(called)}){{{text}}}", called
        if called in _FUNCTIONS:
            return f"{_FUNCTIONS[called]}({text})", "double"
        found = self._whole.function(called)
        return f"{found.name}({text})", found.returns


def _literal(value: float) -> Typed:
    if isinstance(value, int):
        return str(value), "int"
    if not math.isfinite(value):
        raise NotCarriedError(f"the number {value}")
    text = repr(value)
    return text if any(mark in text for mark in ".e") else f"{text}.0", "double"


PRELUDE = """\
static double lesser(double a, double b) { return b < a ? b : a; }
static double greater(double a, double b) { return b > a ? b : a; }
static int lesser_int(int a, int b) { return b < a ? b : a; }
static int greater_int(int a, int b) { return b > a ? b : a; }
"""
"""What the translated functions call beside the C library."""
