"""What every HTML page of the tool shares: filled from a template, self-contained, written whole.

A page loads nothing: style, script, pictures and data go inside it. What comes from files is
escaped by the template engine.
"""

import base64
import importlib.util
import math
from collections.abc import Callable, Mapping
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from eps_hil import provenance
from eps_hil.errors import InputError
from eps_hil.recordings.files import replacing
from eps_hil.unit_words import of, spaced


def check(asked: str = "--report", *libraries: str) -> None:
    """:class:`InputError` where jinja2 or one of ``libraries`` is not installed.

    ``asked`` is the option or verb that wants the page.
    """
    if any(importlib.util.find_spec(name) is None for name in ("jinja2", *libraries)):
        raise InputError(
            asked, "", "a page needs the 'report' extra", 'pip install "eps_hil[report]"'
        )


def fill(
    template: str,
    package: str = "eps_hil.report",
    filters: Mapping[str, Callable[..., str]] | None = None,
    **values: Any,
) -> str:
    """The page's HTML from a template of ``package``; a name it lacks is an error.

    ``filters`` of the template stand beside ``number``, ``unit`` (of a column) and ``spaced`` (a
    unit behind its number).
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update({"number": number, "unit": of, "spaced": spaced, **(filters or {})})
    return environment.get_template(template).render(**values)


def write(path: Path, page: str) -> None:
    """Write the page whole or not at all, with where it comes from at its end."""
    before, end, after = page.rpartition("</body>")
    with replacing(path) as temporary:
        temporary.write_text(before + (_footer() if end else "") + end + after, encoding="utf-8")


def _footer() -> str:
    made = provenance.content()
    machine = made["machine"]
    lines = [
        f"eps_hil {made['version']}, catalogue {made['catalogue']}, {made['date']}",
        made["command"] or "called from a program",
        *(f"{file['path']}: SHA-256 {file['sha256'] or 'not readable'}" for file in made["files"]),
        f"{machine['name']}: {machine['system']}, {machine['cores']} cores, "
        f"Python {machine['python']}",
    ]
    return f"<footer><pre>{escape(chr(10).join(lines))}</pre></footer>\n"


def asset(name: str) -> str:
    """A style or script of the package, for putting inside a page."""
    return (files("eps_hil.report") / "assets" / name).read_text(encoding="utf-8")


def library(name: str) -> str:
    """A script or style of uPlot (MIT licence), as the package uplot-python brings it."""
    found = importlib.util.find_spec("uplot")
    if found is None or not found.submodule_search_locations:
        raise InputError("a page", "", "needs uPlot", "pip install uplot-python")
    (folder, *_) = found.submodule_search_locations
    return (Path(folder) / "static" / name).read_text(encoding="utf-8")


def picture(path: Path) -> str:
    """A PNG file as the source of an image inside a page."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")


def number(value: Any, digits: int = 3) -> str:
    """A value for reading: three digits, a minus that is one, and "–" for none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    text = f"{value:.{digits}g}"
    if "e" in text and 1.0 <= abs(value) < 1e6:
        text = f"{value:.0f}"
    return text.replace("e-0", "e-").replace("e+0", "e").replace("-", "−")
