"""``eps-hil prove concealed`` from nothing to a page, on one case of the development seeds."""

import json
from pathlib import Path

import pytest

from eps_hil.cli.main import main

pytestmark = pytest.mark.slow


def test_one_case_from_hiding_to_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, result = tmp_path / "proof", tmp_path / "proof.json"
    given = ["prove", "concealed", "--development", "--seed", "3", "--cases", "1"]
    given += ["--jobs", "1", "--out", str(out), "--json", str(result)]
    assert main(given) == 0
    said = capsys.readouterr().out
    seal = (out / "seals.txt").read_text().split()[1]
    assert said.index(seal) < said.index("seal opened") < said.index("right name first")
    (line,) = map(json.loads, (out / "cases.jsonl").read_text().splitlines())
    assert line["diagnosis"]["schema"] == "eps-hil/diagnosis/1"
    force = {name: one["rack_force_rmse_n"] for name, one in line["worth"].items()}
    assert force["oracle"] < force["baseline"]
    assert 0 < force["augmented"] < 2 * force["baseline"]
    assert json.loads(result.read_text())["cases"] == 1
    assert "1 cases" in (out / "index.html").read_text()
    # the same again is refused, and with --resume only the page is written anew
    assert main(given) == 2
    assert "--resume" in capsys.readouterr().err
    assert main([*given, "--resume"]) == 0
    assert "sha256" not in capsys.readouterr().out
