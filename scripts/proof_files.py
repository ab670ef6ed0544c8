"""Which sources made the proof's figures: a digest of them, to be told beside the figures.

    python scripts/proof_files.py            of the sources as they are
    python scripts/proof_files.py COMMIT     of a commit

All of eps_hil/physics; of eps_hil/diagnosis what ``eps-hil diagnose`` is made of: what it imports,
and what that imports; and what hides and judges: eps_hil/proof and eps_hil/oracle/closed_loop.py.
What only ``eps-hil changes`` imports has no part in the proof.
"""

import ast
import hashlib
import subprocess
import sys
import tarfile
import tempfile
from io import BytesIO
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PHYSICS, DIAGNOSIS = "eps_hil/physics", "eps_hil/diagnosis"
PROOF, CLOSED_LOOP = "eps_hil/proof", "eps_hil/oracle/closed_loop.py"
BEGIN = "eps_hil.diagnosis.diagnose"


def digest(root: Path) -> str:
    """Seven digits of the contents of those files under ``root``."""
    files = {*(root / PHYSICS).rglob("*.py"), *_imported(root, BEGIN, set())}
    files |= {*(root / PROOF).rglob("*.py"), root / CLOSED_LOOP}
    total = hashlib.sha256()
    for file in sorted(files):
        total.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes())
    return total.hexdigest()[:7]


def of_commit(commit: str) -> str:
    """The same of a commit of this repository."""
    words = ["git", "archive", commit, PHYSICS, DIAGNOSIS, PROOF, CLOSED_LOOP]
    packed = subprocess.run(words, cwd=ROOT, capture_output=True, check=True).stdout
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=BytesIO(packed)) as tar:
        tar.extractall(folder, filter="data")
        return digest(Path(folder))


def _imported(root: Path, module: str, seen: set[Path]) -> set[Path]:
    """Files of eps_hil/diagnosis that a module is made of, its own among them; adds to ``seen``."""
    place = root / module.replace(".", "/")
    file = place.with_suffix(".py") if place.with_suffix(".py").exists() else place / "__init__.py"
    if not module.startswith(DIAGNOSIS.replace("/", ".")) or not file.exists() or file in seen:
        return seen
    seen.add(file)
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for each in node.names:
                _imported(root, each.name, seen)
        elif isinstance(node, ast.ImportFrom) and node.module:
            _imported(root, node.module, seen)
            for each in node.names:
                _imported(root, f"{node.module}.{each.name}", seen)
    return seen


if __name__ == "__main__":
    sys.stdout.write(f"{of_commit(sys.argv[1]) if sys.argv[1:] else digest(ROOT)}\n")
