"""How results reach a notebook: data frames, small HTML tables, figures that show themselves."""

import io
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from eps_hil.errors import InputError

LIBRARIES = ("pandas", "polars")


def dataframe(columns: Mapping[str, Any], library: str | None = None) -> Any:
    """``columns`` (equally long, by name) as a data frame of ``library``.

    None: pandas where it is installed, else polars. :class:`InputError` where it is not.
    """
    from importlib import import_module
    from importlib.util import find_spec

    if library is not None and library not in LIBRARIES:
        raise InputError("to_dataframe", "library", f"'{library}' is none", "pandas or polars")
    there = [name for name in (library or "",) * bool(library) or LIBRARIES if find_spec(name)]
    if not there:
        missing = library or " or ".join(LIBRARIES)
        raise InputError("to_dataframe", "", f"needs {missing}", f"pip install {missing[:6]}")
    return import_module(there[0]).DataFrame(dict(columns))


def table(rows: Sequence[Mapping[str, object]], title: str) -> str:
    """Rows of equal keys as an HTML table; everything in it is escaped."""
    heads = list(rows[0]) if rows else []
    head = "".join(f"<th>{escape(str(name))}</th>" for name in heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(_text(row[name]))}</td>" for name in heads) + "</tr>"
        for row in rows
    )
    return f"<p><b>{escape(title)}</b></p><table><tr>{head}</tr>{body}</table>"


def _text(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def shown(figure: Any) -> Any:
    """A matplotlib figure that a notebook draws without being told to."""

    def png() -> bytes:
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=80)
        return buffer.getvalue()

    figure._repr_png_ = png
    return figure
