"""The reproduction as one self-contained HTML page: statements first, then figures and tables."""

import base64
from pathlib import Path

from eps_hil.errors import InputError
from eps_hil.recordings.files import replacing
from eps_hil.reproduction.reproduce import Reproduction
from eps_hil.reproduction.result import Outcome


def check() -> None:
    """:class:`InputError` where the library that fills the page is not installed."""
    try:
        import jinja2  # noqa: F401
    except ImportError:
        raise InputError(
            "reproduce", "", "the page needs the 'report' extra", 'pip install "eps_hil[report]"'
        ) from None


def write(made: Reproduction, path: Path) -> None:
    """Write the page whole or not at all; it loads nothing from elsewhere."""
    check()
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("eps_hil.reproduction"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    pictures = {
        result.key: base64.b64encode(result.picture.read_bytes()).decode("ascii")
        for result in made.results
        if result.picture
    }
    page = environment.get_template("reproduction.html.jinja").render(
        made=made, pictures=pictures, outcomes=list(Outcome)
    )
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
