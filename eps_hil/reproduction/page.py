"""The reproduction as one self-contained HTML page: statements first, then figures and tables."""

from pathlib import Path

from eps_hil.report import page
from eps_hil.reproduction.reproduce import Reproduction
from eps_hil.reproduction.result import Outcome


def write(made: Reproduction, path: Path) -> None:
    """Write the page whole or not at all; it loads nothing from elsewhere."""
    pictures = {one.key: page.picture(one.picture) for one in made.results if one.picture}
    filled = page.fill(
        "reproduction.html.jinja",
        "eps_hil.reproduction",
        made=made,
        pictures=pictures,
        css=page.asset("page.css"),
        outcomes=list(Outcome),
    )
    page.write(path, filled)
