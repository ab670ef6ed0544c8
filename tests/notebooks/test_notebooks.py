"""Every notebook runs from its first cell to its last, as committed: without outputs."""

import json
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))

SHOWN = {
    "first_diagnosis": ("stribeck 9",),  # named, with 90 % or more
    "estimate_and_compare": ("rms error moving in N", "w/o FC", "smoother"),
    "identify_and_simulate": ("friction.sigma0_nm_per_rad", "identified: "),
}
"""What a reader finds among the outputs of each."""
WRITTEN = {
    "first_diagnosis": "notebook_rig/page.html",
    "estimate_and_compare": "estimate_rig/comparison.png",
    "identify_and_simulate": "identify_rig/identification.html",
}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_committed_without_outputs(path: Path) -> None:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") for cell in cells)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path: Path, tmp_path: Path) -> None:
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    notebook = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(
        notebook, timeout=800, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    outputs = json.dumps(notebook.cells)
    assert all(text in outputs for text in SHOWN[path.stem])
    assert "image/png" in outputs
    assert (tmp_path / WRITTEN[path.stem]).stat().st_size > 10_000


def test_the_way_to_a_named_effect_is_ten_lines() -> None:
    cells = json.loads((FOLDER / "first_diagnosis.ipynb").read_text(encoding="utf-8"))["cells"]
    ten = next(cell for cell in cells if "eps_hil.diagnose(" in "".join(cell["source"]))
    assert sum(bool(line.strip()) for line in "".join(ten["source"]).splitlines()) <= 10
