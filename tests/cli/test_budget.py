"""``eps-hil budget`` as a user calls it."""

import json
from pathlib import Path
from typing import Any

import pytest

from eps_hil.cli.main import main
from eps_hil.errors import InputError
from eps_hil.physics.chain import build_chain
from eps_hil.physics.chain_parameters import ChainParameters
from eps_hil.physics.model import Model

ROOT = Path(__file__).parents[2]
MODEL = str(ROOT / "configs" / "reference_rig.yaml")


@pytest.fixture
def short(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(
        "manoeuvre:\n  name: short\n  segments:\n    - duration_s: 3.0\n"
        "      rack_force_n: {sine: {amplitude: 800.0, frequency_hz: 1.5}}\n"
        "      driver: hands_off\n      motor: {stiffness_nm_per_rad: 0.03}\n",
        encoding="utf-8",
    )
    return path


def test_a_lighter_gear_needs_no_chain_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reference chain's masses left nothing for the rotor, and nobody had given that file."""
    light = tmp_path / "light.yaml"
    light.write_text(Path(MODEL).read_text().replace("2.0e-4 ", "5.0e-5 "), encoding="utf-8")
    chains = []

    def simulated(
        rig: Model, _settings: object, chain: ChainParameters, *_: Any, **__: Any
    ) -> None:
        chains.append(build_chain(rig, chain, 5))
        raise InputError("far", "", "enough")

    monkeypatch.setattr("eps_hil.budget.simulated.simulated_world", simulated)
    assert main(["budget", "--model", str(light)]) == 2
    assert len(chains) == 1


@pytest.mark.slow
def test_table_json_figure_and_advice(
    tmp_path: Path, short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sizes, result, figure = tmp_path / "u.yaml", tmp_path / "b.json", tmp_path / "b.png"
    sizes.write_text("uncertainty: {percent: {offset_pos_nm: 40}}\n", encoding="utf-8")
    words = ["budget", "--model", MODEL, "--uncertainty", str(sizes), "--manoeuvre", str(short)]
    page = tmp_path / "b.html"
    words += ["--json", str(result), "--figure", str(figure), "--report", str(page)]
    assert main([*words, "--draws", "4"]) == 0
    said = capsys.readouterr().out
    assert "moving: friction levels first" in said
    found = json.loads(result.read_text(encoding="utf-8"))
    assert found["schema"] == "eps-hil/budget/1"
    assert found["sources"][0]["source"] == "offset_pos_nm"
    assert found["sources"][0]["standard_deviation"] == pytest.approx(0.4 * 0.056)
    assert found["phases"]["moving"]["total_n"] > found["phases"]["moving"]["method_n"]
    assert figure.stat().st_size > 10_000
    html = page.read_text(encoding="utf-8")
    assert html.index("friction levels first") < html.index("offset_pos_nm")
    assert "data:image/png;base64," in html
    assert "http://" not in html
    assert "https://" not in html
    assert f"{found['phases']['moving']['total_n']:.3g} N" in html


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--model", "none.yaml"], "no such file"),
        (["--model", MODEL, "--manoeuvre", "none"], "no such manoeuvre"),
        (["--model", MODEL, "--uncertainty", "none.yaml"], "no such file"),
        (["--model", MODEL, "--order", "7"], "--order"),
        (["--model", MODEL, "--report", "no/such/folder/b.html"], "no/such/folder"),
    ],
)
def test_bad_words(capsys: pytest.CaptureFixture[str], words: list[str], said: str) -> None:
    assert main(["budget", *words]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert said in err
