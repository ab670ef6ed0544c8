"""Every claim of docs/safety.md that can be tested has a test; sentence, code and test are there.

That each of these tests fails without the mechanism is shown by scripts/safety_claims, which takes
minutes.
"""

import ast
import re
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENT = re.sub(r"\s+", " ", (ROOT / "docs" / "safety.md").read_text(encoding="utf-8"))


def _script() -> ModuleType:
    import sys

    loader = SourceFileLoader("safety_claims", str(ROOT / "scripts" / "safety_claims"))
    spec = spec_from_loader("safety_claims", loader)
    assert spec is not None
    module = module_from_spec(spec)
    sys.modules["safety_claims"] = module
    loader.exec_module(module)
    return module


SCRIPT = _script()
CLAIMS: tuple[Any, ...] = SCRIPT.CLAIMS


def _tests_of(path: Path) -> set[str]:
    """``Class::test`` and ``test`` of a file."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef):
            found.add(node.name)
        elif isinstance(node, ast.ClassDef):
            found |= {f"{node.name}::{f.name}" for f in node.body if isinstance(f, ast.FunctionDef)}
    return found


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.name)
def test_a_claim_has_its_sentence_its_mechanism_and_its_tests(claim: Any) -> None:
    assert re.sub(r"\s+", " ", claim.says) in DOCUMENT
    assert SCRIPT.applied(claim)  # the code to take out stands in the file once
    assert claim.tests
    for test in claim.tests:
        file, _, name = test.partition("::")
        assert name in _tests_of(ROOT / file), test


def test_the_list_is_the_scripts() -> None:
    written = (ROOT / SCRIPT.LIST).read_text(encoding="utf-8")
    assert written == SCRIPT.table(), "run scripts/safety_claims --write"


def test_names_are_used_once() -> None:
    names = [claim.name for claim in CLAIMS]
    assert len(set(names)) == len(names)


def test_every_limit_has_a_claim() -> None:
    """A limit that is added to the guard has to be added here too."""
    text = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    table = text[text.index("| limit | ceiling |") :]
    rows = [row.split("|") for row in table[: table.index("\n\n")].splitlines()[2:]]
    for row in rows:
        trips = re.sub(r"\s+", " ", row[3]).strip()
        if trips:
            assert any(re.sub(r"\s+", " ", claim.says) in trips for claim in CLAIMS), trips
