"""What every page shares."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest
from jinja2 import TemplateNotFound, UndefinedError

from eps_hil.errors import InputError
from eps_hil.report import page


def test_a_missing_library_is_told_before_any_work(monkeypatch: pytest.MonkeyPatch) -> None:
    page.check("--report", "matplotlib")
    there = importlib.util.find_spec

    def without(name: str) -> object:
        return None if name == "matplotlib" else there(name)

    monkeypatch.setattr(importlib.util, "find_spec", without)
    page.check()
    with pytest.raises(InputError, match=r"prove.*'report' extra.*pip install"):
        page.check("prove", "matplotlib")


def test_a_template_gets_all_it_names_or_fails() -> None:
    with pytest.raises(UndefinedError):
        page.fill("identification.html.jinja")
    with pytest.raises(TemplateNotFound):
        page.fill("none.html.jinja")


def test_the_plotting_library_comes_from_its_package() -> None:
    assert "uPlot" in page.library("uPlot.iife.js")
    assert "</script" not in page.library("uPlot.iife.js")
    assert ".uplot" in page.library("uPlot.min.css")


def test_what_the_library_requires_is_never_run() -> None:
    asked = (
        "import sys; from eps_hil.dashboard.server import assets; assets(); "
        "print(sorted({'uplot', 'IPython'} & set(sys.modules)))"
    )
    said = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


def test_a_page_that_cannot_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    page.write(path, "<p>old")
    with pytest.raises(UnicodeEncodeError):
        page.write(path, "<p>\ud800")
    assert path.read_text() == "<p>old"
    assert list(tmp_path.iterdir()) == [path]
