"""What the estimator remembers as plain Python, for an answer before anything is compiled.

The kernels are Python too. Interpreted on numpy's records a step takes longer to look its fields up
than to work; here the same fields are attributes of an ordinary object. Same source, same order of
operations, same bits.
"""

from typing import Any

import numpy as np


class Record:
    """One record: its fields are attributes, arrays among them lists."""


class Numbers(list[Any]):
    """Numbers of one array that takes a scalar to all of them."""

    def __iadd__(self, much: Any) -> "Numbers":  # type: ignore[misc]
        for k, one in enumerate(self):
            self[k] = one + much
        return self


class Table(dict[tuple[int, int], Any]):
    """Numbers of an array of two dimensions, by their places."""


class Records(list[Record]):
    """Records of an array; setting one sets its fields, as numpy does."""

    def __setitem__(self, k: Any, other: Any) -> None:
        fields = vars(self[k])
        for name, value in fields.items():
            new = getattr(other, name)
            if isinstance(value, Numbers):
                value[:] = new.tolist() if isinstance(new, np.ndarray) else new
            else:
                fields[name] = new.item() if isinstance(new, np.generic) else new


def plain(value: Any) -> Any:
    """``value``, a named tuple of arrays, records and named tuples, with what it holds as Python.

    Arrays of one dimension become lists, those of two :class:`Table`, those of more stay.
    """
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*(plain(part) for part in value))
    if not isinstance(value, np.ndarray):
        return value
    if value.dtype.names:
        return Records(_record(one) for one in value)
    if value.ndim == 2:
        rows = value.tolist()
        return Table(((i, k), one) for i, row in enumerate(rows) for k, one in enumerate(row))
    return Numbers(value.tolist()) if value.ndim == 1 else value


def _record(one: Any) -> Record:
    made = Record()
    for name in one.dtype.names:
        value = one[name]
        setattr(made, name, plain(value) if isinstance(value, np.ndarray) else value.item())
    return made
