"""No command writes over what it reads: asked of every verb before its work.

A verb tells by the names of its options which files it writes (:data:`WRITTEN`); all others, and
what the YAML files among them name, it reads.
"""

import functools
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from eps_hil.errors import InputError

WRITTEN = frozenset(
    {
        "figure", "fmu", "journal", "json", "log_estimates", "marks", "out", "report", "target",
        "traces", "write_effect", "write_manoeuvre", "write_model",
    }
)  # fmt: skip
"""Options and arguments that name what is written, a file or a folder."""
_IN_PLACE = "write_model"
"""``calibrate`` may write levels into the model that its configuration names."""


def check_apart(outputs: Iterable[Path | None], inputs: Iterable[Path | None]) -> None:
    """:class:`InputError` for an output that is an input, however it is spelt or linked, or that
    is named twice."""
    written = [path for path in outputs if path is not None]
    read = [path for path in inputs if path is not None]
    for k, path in enumerate(written):
        if any(_same(path, other) for other in written[:k]):
            raise InputError(path, "", "is the name of two outputs", "give each its own name")
        if not path.is_dir() and any(_same(path, other) for other in read):
            raise InputError(path, "", "is read by this command", "write to another file")


def keeps_inputs(verb: Callable[..., Any]) -> Callable[..., Any]:
    """The verb, which refuses to write over what it is given to read."""

    @functools.wraps(verb)
    def command(*arguments: Any, **values: Any) -> Any:
        names = sorted(WRITTEN & values.keys())
        written = {name: one for name in names for one in _paths(values[name])}
        read = [one for name in sorted(values.keys() - WRITTEN) for one in _paths(values[name])]
        check_apart(written.values(), read)
        named = [one for path in read for one in named_in(path)] if written else []
        check_apart([path for name, path in written.items() if name != _IN_PLACE], named)
        return verb(*arguments, **values)

    return command


def _paths(value: Any) -> list[Path]:
    given = value if isinstance(value, list | tuple) else (value,)
    return [one for one in given if isinstance(one, Path)]


def named_in(path: Path) -> Iterator[Path]:
    """Files that a YAML file names, as it names them: relative to its folder."""
    from eps_hil import yaml_file
    from eps_hil.bus.config import resolved

    if path.suffix.lower() not in {".yaml", ".yml"} or not path.is_file():
        return
    try:
        content = yaml_file.read(path)
    except (InputError, OSError):  # whoever reads it says so
        return
    for word in _words(content):
        try:
            named = resolved(path, word)
            if named.is_file():
                yield named
        except (OSError, RuntimeError, ValueError):  # a text that cannot be a name
            continue


def _words(content: Any) -> Iterator[str]:
    if isinstance(content, str):
        yield content
    for one in content.values() if isinstance(content, dict) else ():
        yield from _words(one)
    for one in content if isinstance(content, list) else ():
        yield from _words(one)


def _same(one: Path, other: Path) -> bool:
    try:
        return one.resolve() == other.resolve() or one.samefile(other)
    except OSError:  # one of them is not there
        return False
