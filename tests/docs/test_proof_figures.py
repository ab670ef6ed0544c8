"""The proof's figures in README and docs: of the code as it is, or said not to be (issue 19)."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TREES = ("eps_hil/diagnosis", "eps_hil/physics")
MADE_BY = re.compile(
    r"commit [0-9a-f]{7} \(trees ([0-9a-f]{7}), ([0-9a-f]{7})(; not repeated since)?\)"
)
"""The commit, and what ``git rev-parse COMMIT:FOLDER`` says of both folders, seven digits."""


def _trees() -> tuple[str, ...]:
    words = ["git", "rev-parse", *(f"HEAD:{tree}" for tree in TREES)]
    said = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    return tuple(one[:7] for one in said.stdout.split())


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a clone: nothing to compare with")
def test_they_are_of_the_code_as_it_is_or_say_that_they_are_not() -> None:
    page = (ROOT / "docs" / "proof.md").read_text(encoding="utf-8")
    made_by = MADE_BY.search(page)
    assert made_by is not None, "docs/proof.md: no `commit … (trees …, …)` beside the figures"
    *trees, older = made_by.groups()
    assert (tuple(trees) != _trees()) == (older is not None), (
        f"docs/proof.md: the figures are of trees {trees}, those of now are {_trees()}"
    )
    front = (ROOT / "README.md").read_text(encoding="utf-8")
    line = next(one for one in front.splitlines() if "concealed cases" in one)
    assert ("not repeated since" in line) == (older is not None), f"README.md: {line}"
