"""The field's terms: none of the old private ones on pages, in documentation or in messages."""

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from eps_hil.physics.effects.catalogue import catalogue

ROOT = Path(__file__).parents[2]
OLD = {
    "left over": "residual",
    "what is left(?! out)": "the residual, the rest",
    "model file as it was(?! given)": "baseline model",
    "put right": "corrected",
    "rubs": "causes friction",
    "leave over": "the residual",
    "noise variances": "Δχ²",
    "model as it was": "baseline model",
    "comes near enough": "fits as well",
    "rubs nothing": "causes no friction",
    "hangs together within": "autocorrelation time",
    "hang together": "are correlated",
}
PAGES = [
    *sorted((ROOT / "docs").glob("*.md")),
    ROOT / "README.md",
    *sorted((ROOT / "eps_hil").rglob("*.jinja")),
]


@functools.cache
def shown(path: Path) -> tuple[str, ...]:
    """Texts of a Python file that a user may read: all its strings but docstrings."""
    return tuple(_strings(path))


def _strings(path: Path) -> Iterator[str]:
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    doc = {
        id(node.value)
        for node in nodes
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in doc:
            yield node.value


@pytest.mark.parametrize("old", OLD)
def test_the_fields_terms_are_used(old: str) -> None:
    pattern = re.compile(old.replace(" ", r"\s+"), re.I)
    wrong = [str(path.relative_to(ROOT)) for path in PAGES if pattern.search(path.read_text())]
    for path in sorted((ROOT / "eps_hil").rglob("*.py")):
        if any(pattern.search(text) for text in shown(path)):
            wrong.append(str(path.relative_to(ROOT)))
    assert not wrong, f"'{old}': write '{OLD[old]}'"


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_an_effect_is_titled_by_its_name_in_the_field(name: str) -> None:
    title = catalogue()[name].name
    assert catalogue()[name].title == title
    assert title[0].isupper()
    assert "_" not in title


def test_the_glossary_explains_what_the_measures_are_called() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text()
    for term in ("torque residual", "NRMSE", "baseline model", "augmented model", "hold-out",
                 "log-likelihood ratio", "innovation", "autocorrelation time"):  # fmt: skip
        assert f"- **{term}**: " in text, term
