"""JSON of unknown origin: what is not read is a ValueError, of whatever kind it is. And our own."""

import json
import math
from collections.abc import Callable, Iterable
from typing import Any

_DEEPEST = 100
"""Lists and objects within each other; what this package writes has less than ten."""


def parse(text: str | bytes, *, pairs: Callable[[list[tuple[str, Any]]], Any] | None = None) -> Any:
    """Plain values of a text; ``pairs`` makes something of each object's.

    What walks through them need not fear for the stack.
    """
    try:
        content = json.loads(text, object_pairs_hook=pairs)
    except RecursionError:
        raise _deep() from None
    level = _collections([content])
    for _ in range(_DEEPEST + 1):
        if not level:
            return content
        level = [
            one
            for each in level
            for one in _collections(each.values() if isinstance(each, dict) else each)
        ]
    raise _deep()


def plain(content: Any) -> Any:
    """``content`` as we write it: keys are text, and a number that does not exist is null."""
    if isinstance(content, dict):
        return {str(key): plain(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [plain(value) for value in content]
    if isinstance(content, float) and not math.isfinite(content):
        return None
    return content


def _collections(values: Iterable[Any]) -> list[Any]:
    return [one for one in values if isinstance(one, dict | list)]


def _deep() -> ValueError:
    return ValueError(f"nested deeper than {_DEEPEST} levels")
