"""The proof shares no code with what it examines: read from the sources themselves."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "eps_hil"
ALLOWED = {
    "eps_hil.compiled",
    "eps_hil.errors",
    "eps_hil.examples",
    "eps_hil.proof",
    "eps_hil.bus",
    "eps_hil.json_text",
    "eps_hil.yaml_file",
}
"""What the proof may use of the package: nothing that knows physics."""
EXAMINED = ("physics", "estimation", "identification", "adaptation", "diagnosis", "rig", "service")


def _imports(source: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(source.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{source}: relative import"
            yield str(node.module)
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("source", sorted((PACKAGE / "proof").glob("*.py")), ids=lambda p: p.name)
def test_proof_imports_nothing_that_it_examines(source: Path) -> None:
    ours = {".".join(name.split(".")[:2]) for name in _imports(source)}
    assert {name for name in ours if name.startswith("eps_hil.")} <= ALLOWED


@pytest.mark.parametrize("folder", EXAMINED)
def test_what_is_examined_does_not_know_the_proof(folder: str) -> None:
    for source in (PACKAGE / folder).rglob("*.py"):
        assert not any(name.startswith("eps_hil.proof") for name in _imports(source)), source
        assert "eps_hil.proof" not in source.read_text(), source
