"""The documentation as a site: ``scripts/docs`` builds it, a warning is an error."""

import re

from sphinx.application import Sphinx

from eps_hil import __version__

project = "eps_hil"
author = "the eps_hil authors"
version = release = __version__
extensions = ["myst_parser"]
exclude_patterns = ["notebooks", "site"]
myst_heading_anchors = 4
html_theme = "furo"
html_title = f"eps_hil {__version__}"
html_copy_source = False
html_show_sphinx = False


def _contents(_app: Sphinx, name: str, source: list[str]) -> None:
    """The index's lists of links are the site's contents: each heading in bold is a part."""
    if name != "index":
        return
    parts = re.split(r"^\*\*(.+?)\*\*$", source[0], flags=re.M)
    start = re.findall(r"\]\(([\w-]+)\.md\)", parts[0])
    for caption, text in [("Start", "\n".join(start)), *zip(parts[1::2], parts[2::2], strict=True)]:
        pages = (
            start if caption == "Start" else re.findall(r"^- \[.*?\]\(([\w-]+)\.md\)", text, re.M)
        )
        listed = "\n".join(pages)
        source[0] += f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{listed}\n```\n"


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", _contents)
