"""YAML file -> validated value. Every error names file, line, field and what was expected."""

import contextlib
import dataclasses
import difflib
import functools
import io
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import TypeAdapter, ValidationError

from eps_hil.errors import InputError

T = TypeVar("T")

_MAX_SHOWN = 3
_NEARLY = 0.85
"""Alike enough to be meant: effect and effects; not friction_map and friction."""
_LARGEST_BYTES, _DEEPEST, _MOST_VALUES = 1_000_000, 100, 1_000_000
"""What nobody writes by hand; the last one with each alias written out. Beyond, the parser would
run out of stack, memory or time."""
_LONGEST_SHOWN = 100
_ANOTHER_FILE = "check that this is the file you meant"


class _RefusedError(yaml.MarkedYAMLError):
    """Good syntax that is not read all the same; with what to do."""

    def __init__(self, problem: str, mark: Any, remedy: str = _ANOTHER_FILE) -> None:
        super().__init__(problem=problem, problem_mark=mark)
        self.remedy = remedy


class _Telling:
    """A loader that names the place of a scalar which is not what it looks like (month 13)."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """As the loader does it."""
        above: Any = super()
        try:
            return above.construct_object(node, deep=deep)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
            kind = node.tag.rpartition(":")[2]
            found = f": {_shown(node.value)}" if isinstance(node, yaml.ScalarNode) else ""
            problem = f"cannot be read as {kind}{found}"
            remedy = "correct it, or put it in quotes"
            raise _RefusedError(problem, node.start_mark, remedy) from None


class _Exact(_Telling, yaml.SafeLoader):
    """PyYAML itself: says best what is wrong with a text."""


class _Quick(_Telling, getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """libyaml, where PyYAML was built with it."""


def read(path: str | Path) -> Any:
    """Parse one YAML file into plain values; :class:`InputError` if missing or broken."""
    text = _text(Path(path))
    try:
        return parse(text)
    except _RefusedError as error:
        raise InputError(path, _where(error), str(error.problem), error.remedy) from None
    except yaml.reader.ReaderError as error:
        line = f"line {text.count(chr(10), 0, error.position) + 1}"
        problem = f"not valid YAML: holds the character #x{error.character:04x}"
        raise InputError(path, line, problem, "take it out") from None
    except yaml.YAMLError as error:
        problem = f"not valid YAML: {getattr(error, 'problem', None) or 'not readable'}"
        raise InputError(path, _where(error), problem, "mend the syntax") from None


def parse(text: str) -> Any:
    """Plain values of a text; :class:`yaml.YAMLError` if there are none in it."""
    if "\t" not in text:  # libyaml lets some of them pass
        try:
            return _parsed(text, _Quick)
        except _RefusedError:
            raise
        except yaml.YAMLError:
            pass
    return _parsed(text, _Exact)


def _where(error: yaml.YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    return f"line {mark.line + 1}, column {mark.column + 1}" if mark else ""


def _parsed(text: str, kind: Any) -> Any:
    _refuse_deep(kind(text))
    loader = kind(text)
    node = loader.get_single_node()
    if node is None:
        return None
    _refuse_twice(node, set())
    _count(node, {})
    return loader.construct_document(node)


def _refuse_deep(loader: Any) -> None:
    """Before anything that descends does: lists and mappings within each other."""
    depth = 0
    while loader.check_event():
        event = loader.get_event()
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            problem = f"nested deeper than {_DEEPEST} levels; a YAML file of settings was expected"
            raise _RefusedError(problem, event.start_mark)


def _count(node: yaml.Node, known: dict[int, int]) -> int:
    """How many values stand in ``node``, each alias written out; 0 in ``known``: being counted."""
    if not isinstance(node, yaml.CollectionNode):
        return 1
    if id(node) in known:
        if not known[id(node)]:
            raise _RefusedError("holds itself through an alias", node.start_mark, "write it out")
        return known[id(node)]
    known[id(node)] = 0
    pairs = isinstance(node, yaml.MappingNode)
    parts = [part for pair in node.value for part in pair] if pairs else node.value
    known[id(node)] = total = 1 + sum(_count(part, known) for part in parts)
    if total > _MOST_VALUES:
        problem = f"aliases make more than {_MOST_VALUES:,} values of it"
        raise _RefusedError(problem, node.start_mark, "write out what is needed of them")
    return total


def _refuse_twice(node: yaml.Node, known: set[int]) -> None:
    """A key that a mapping holds twice: YAML forbids it, and PyYAML takes the last one."""
    if id(node) in known or not isinstance(node, yaml.CollectionNode):
        return
    known.add(id(node))
    first: dict[str, int] = {}
    for one in node.value:
        if not isinstance(node, yaml.MappingNode):
            _refuse_twice(one, known)
            continue
        key, value = one
        _refuse_twice(value, known)
        if isinstance(key, yaml.ScalarNode):
            line = key.start_mark.line + 1
            if key.value in first:
                problem = f"'{key.value}' stands here and on line {first[key.value]}"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            first[key.value] = line


def load(path: str | Path, kind: type[T], *, section: str = "") -> T:
    """Read ``path`` (or its top-level ``section``) and validate it as ``kind``.

    ``kind`` is anything pydantic can validate: a (frozen) dataclass, a model, a typed dict.
    """
    content = read(path)
    if section:
        if not isinstance(content, dict) or section not in content:
            raise InputError(path, section, "section is missing", _block_remedy(content, section))
        _refuse_fields_beside(path, content, kind, section)
        content = content[section]
    return validate(path, content, kind, section=section)


def _block_remedy(content: Any, section: str) -> str:
    keys = [str(key) for key in content] if isinstance(content, dict) else []
    near = difflib.get_close_matches(section, keys, n=1)
    return f"rename '{near[0]}:' to '{section}:'" if near else f"add a '{section}:' block"


def _refuse_fields_beside(
    path: str | Path, content: dict[Any, Any], kind: Any, section: str
) -> None:
    """Other blocks may stand beside a section; its own fields would be ignored there."""
    fields = (
        [one.name for one in dataclasses.fields(kind)] if dataclasses.is_dataclass(kind) else []
    )
    for key in content:
        near = difflib.get_close_matches(str(key), fields, n=1, cutoff=_NEARLY)
        if near and key != section:
            problem = f"stands beside '{section}:', where it has no effect"
            remedy = f"indent it below '{section}:', as {near[0]}"
            raise InputError(path, f"{_place(Path(path), (key,))}, {key}", problem, remedy)


def validate(path: str | Path, content: Any, kind: type[T], *, section: str = "") -> T:
    """Validate parsed content as ``kind``; the file is named in errors, with the line."""
    asked: Any = kind  # hashable, which its type does not say
    try:
        return _adapter(asked).validate_python(content)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        prefix = (section,) if section else ()
        first = _place(Path(path), prefix + problems[0]["loc"])
        shown = "; ".join(
            f"{_dotted(prefix + p['loc'])}: {_said(p)}" for p in problems[:_MAX_SHOWN]
        )
        more = f" (and {len(problems) - _MAX_SHOWN} more)" if len(problems) > _MAX_SHOWN else ""
        raise InputError(path, first, shown + more, "correct the field") from None


@functools.cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    """Making one takes tens of milliseconds for the larger configurations."""
    return TypeAdapter(kind)


def _said(problem: Any) -> str:
    message = str(problem["msg"])
    if problem["type"] in {"missing", "unexpected_keyword_argument", "extra_forbidden"}:
        return {"missing": "is missing"}.get(problem["type"], "is not a known field")
    return f"{message} (found {_shown(problem['input'])})"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[: _LONGEST_SHOWN - 1]}…"


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(_LARGEST_BYTES + 1)
        if len(content) <= _LARGEST_BYTES:
            return io.TextIOWrapper(io.BytesIO(content), encoding="utf-8").read()
    except FileNotFoundError:
        raise InputError(path, "", "no such file", "check the path") from None
    except IsADirectoryError:
        raise InputError(path, "", "is a folder, a YAML file was expected") from None
    except UnicodeDecodeError:
        raise InputError(path, "", "is not UTF-8 text, a YAML file was expected") from None
    except OSError as error:
        raise InputError(path, "", f"cannot be read: {error.strerror}") from None
    largest = f"{_LARGEST_BYTES / 1e6:g} MB"
    problem = f"is larger than {largest}, a YAML file of settings was expected"
    raise InputError(path, "", problem, _ANOTHER_FILE)


def _dotted(loc: tuple[int | str, ...]) -> str:
    # pydantic marks a wrong key of a mapping by a last part of its own
    return ".".join(str(part) for part in loc if part != "[key]") or "top level"


def _composed(text: str) -> yaml.Node | None:
    with contextlib.suppress(yaml.YAMLError):
        return yaml.compose(text, Loader=_Quick)
    return yaml.compose(text, Loader=_Exact)


def _place(path: Path, loc: tuple[int | str, ...]) -> str:
    """The line of the deepest node of ``loc`` that exists."""
    node = _composed(_text(path))
    line = node.start_mark.line + 1 if node else 1
    for part in loc:
        child = None
        if isinstance(node, yaml.MappingNode):
            child = next((v for k, v in node.value if k.value == str(part)), None)
            key = next((k for k, v in node.value if k.value == str(part)), None)
            line = key.start_mark.line + 1 if key else line
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            child = node.value[part] if part < len(node.value) else None
            line = child.start_mark.line + 1 if child else line
        if child is None:
            break
        node = child
    return f"line {line}"
