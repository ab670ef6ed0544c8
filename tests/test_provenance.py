"""Every page and JSON file says which tool, command, files and machine it comes from."""

import hashlib
import json
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil import __version__, provenance
from eps_hil.cli.main import main
from eps_hil.report import page

MODEL = Path(__file__).parents[1] / "configs" / "reference_rig.yaml"


def test_a_verbs_json_names_its_inputs(tmp_path: Path, sweep_truth: Any) -> None:
    columns = {name: values[:3000] for name, values in sweep_truth.columns.items()}
    drive, out = tmp_path / "my drive.csv", tmp_path / "e.json"
    table = np.column_stack(list(columns.values()))
    np.savetxt(drive, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    for _ in range(2):  # the second time the output is there already, and still no input
        assert main(["estimate", str(drive), "--model", str(MODEL), "--json", str(out)]) == 0
    found = json.loads(out.read_text(encoding="utf-8"))
    assert found["schema"] == "eps-hil/estimate/1"
    made = found["provenance"]
    assert made["version"] == __version__
    assert made["command"].startswith(f"eps-hil estimate '{drive}' --model ")
    assert [one["path"] for one in made["files"]] == [str(drive), str(MODEL)]
    assert made["files"][0]["sha256"] == hashlib.sha256(drive.read_bytes()).hexdigest()
    date = datetime.fromisoformat(made["date"])
    assert date.utcoffset() == timedelta(0)
    assert abs(datetime.now(UTC) - date) < timedelta(minutes=5)
    assert set(made["machine"]) == {"name", "system", "processor", "cores", "python"}


def test_the_catalogues_version_follows_its_effects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "physics" / "effects"
    folder.mkdir(parents=True)
    (folder / "mine.py").write_text("A = 1\n")
    before = provenance.content()["catalogue"]
    assert re.fullmatch("[0-9a-f]{12}", before)
    assert provenance.content()["catalogue"] == before
    monkeypatch.setattr(provenance, "__file__", str(tmp_path / "provenance.py"))
    one = provenance.content()["catalogue"]
    (folder / "mine.py").write_text("A = 2\n")
    assert len({before, one, provenance.content()["catalogue"]}) == 3


def test_a_file_may_stand_behind_an_equals_sign(tmp_path: Path) -> None:
    drive, out = tmp_path / "a=b.csv", tmp_path / "e.json"
    for path in (drive, out):
        path.write_text("x")
    provenance.begin(["diagnose", f"--recording={drive}", f"--model={MODEL}", f"--json={out}"])
    assert [one["path"] for one in provenance.content()["files"]] == [str(drive), str(MODEL)]


def test_several_files_and_words_that_are_none(tmp_path: Path) -> None:
    a, b = tmp_path / "a.log", tmp_path / "b.log"
    a.write_text("a")
    b.write_text("b")
    out = tmp_path / "page.html"
    out.write_text("old")
    words = ["diagnose", "--recording", str(a), "--recording", str(b), "--report", str(out)]
    provenance.begin([*words, "x" * 5000, "\0"])
    assert [one["path"] for one in provenance.content()["files"]] == [str(a), str(b)]
    b.unlink()
    assert provenance.content()["files"][1]["sha256"] is None


def test_a_page_ends_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("<b>.csv").write_text("x")
    provenance.begin(["estimate", "<b>.csv"])
    path = tmp_path / "p.html"
    page.write(path, "<html><body><p>text</p></body></html>")
    text = path.read_text(encoding="utf-8")
    assert text.endswith("</footer>\n</body></html>")
    assert re.search(rf"eps_hil {re.escape(__version__)}, catalogue [0-9a-f]{{12}}, 20", text)
    assert "&lt;b&gt;.csv: SHA-256 " in text
    assert "<b>" not in text
    assert re.search(r"\d+ cores, Python 3\.", text)
