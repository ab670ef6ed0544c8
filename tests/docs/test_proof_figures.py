"""The proof's figures in README and docs: of the code as it is, or said not to be (issue 19)."""

import re
from pathlib import Path

from tests.loaded import loaded

ROOT = Path(__file__).parents[2]
FILES = loaded("scripts/proof_files.py")
MADE_BY = re.compile(
    r"commit [0-9a-f]{7} \(`scripts/proof_files.py`: ([0-9a-f]{7})(; not repeated since)?\)"
)
"""The commit, and the digest of the sources that are in the figures."""


def test_they_are_of_the_code_as_it_is_or_say_that_they_are_not() -> None:
    page = (ROOT / "docs" / "proof.md").read_text(encoding="utf-8")
    made_by = MADE_BY.search(page)
    assert made_by is not None, "docs/proof.md: no commit and digest beside the figures"
    then, older = made_by.groups()
    now = FILES.digest(ROOT)
    assert (then != now) == (older is not None), (
        f"docs/proof.md: the figures are of sources {then}, those of now are {now}"
    )
    front = (ROOT / "README.md").read_text(encoding="utf-8")
    line = next(one for one in front.splitlines() if "concealed cases" in one)
    assert ("not repeated since" in line) == (older is not None), f"README.md: {line}"


def test_the_sources_are_those_that_a_diagnosis_is_made_of(tmp_path: Path) -> None:
    """A change of any of them changes the digest; of what has no part in the proof, not."""
    files = {one.relative_to(ROOT) for one in (ROOT / "eps_hil").rglob("*.py")}
    for file in files:
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_bytes((ROOT / file).read_bytes())
    before = FILES.digest(tmp_path)
    assert before == FILES.digest(ROOT)
    for name, counts in (
        ("eps_hil/diagnosis/changes.py", False),
        ("eps_hil/diagnosis/diagnose.py", True),
        ("eps_hil/diagnosis/attribute/select.py", True),
        ("eps_hil/diagnosis/remainder/grammar.py", True),
        ("eps_hil/physics/effects/stribeck.py", True),
        ("eps_hil/proof/judge.py", True),
    ):
        kept = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(kept + b"\nMORE = 1\n")
        assert (FILES.digest(tmp_path) != before) == counts, name
        (tmp_path / name).write_bytes(kept)
