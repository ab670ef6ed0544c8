"""``eps-hil reproduce --quick`` once: page, pictures, numbers; and what its parts compute."""

import json
import math
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.cli.main import main
from eps_hil.physics.model import load_model
from eps_hil.reproduction import figure12
from eps_hil.reproduction.figure9 import modelled
from eps_hil.reproduction.measures import delay_s, drift_per_s, rms, settling_s
from eps_hil.reproduction.result import Outcome, Statement, Table, at_least, at_most, shown
from eps_hil.reproduction.workbench import Workbench

MODEL = load_model(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")
KEYS = {"fig4", "fig5", "fig7", "table2", "fig9", "fig10", "fig11", "fig12", "fig14"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reproduction")
    out = folder / "made"
    assert main(["reproduce", "--quick", "--out", str(out), "--json", str(out / "r.json")]) == 0
    return out


@pytest.fixture(scope="module")
def content(made: Path) -> dict[str, Any]:
    read: dict[str, Any] = json.loads((made / "r.json").read_text(encoding="utf-8"))
    return read


@pytest.mark.slow
class TestQuickRun:
    def test_every_figure_is_there_as_a_picture(self, made: Path, content: dict[str, Any]) -> None:
        assert content["schema"] == "eps-hil/reproduction/1"
        assert set(content["figures"]) == KEYS
        for each in content["figures"].values():
            head = (made / each["picture"]).read_bytes()[:24]
            assert head.startswith(b"\x89PNG")
            width, height = struct.unpack(">II", head[16:])
            assert min(width, height) > 300
            assert each["tables"]

    def test_the_page_stands_alone_and_says_every_verdict(
        self, made: Path, content: dict[str, Any]
    ) -> None:
        page = (made / "index.html").read_text(encoding="utf-8")
        assert not re.search(r'(?:src|href)="(?!data:|#)', page)
        assert page.count('src="data:image/png;base64,') == len(KEYS)
        count = sum(len(each["statements"]) for each in content["figures"].values())
        assert page.count('<td class="outcome ') == count == sum(content["outcomes"].values())

    def test_verdicts_follow_from_their_numbers(self, content: dict[str, Any]) -> None:
        for figure in content["figures"].values():
            for one in figure["statements"]:
                limits = one["agrees_limit"], one["partly_limit"]
                sign = 1.0 if one["limit_is"] == "at most" else -1.0
                place = sum(sign * one["value"] > sign * limit for limit in limits)
                assert one["outcome"] == ["agrees", "partly", "does not agree"][place], one

    def test_the_procedure_finds_the_rigs_friction(self, content: dict[str, Any]) -> None:
        parameters = content["figures"]["table2"]["tables"][0]["rows"]
        assert [row["parameter"] for row in parameters] == [
            "k0+", "k0-", "kω+", "kω-", "kr+", "kr-",
        ]  # fmt: skip
        away = {row["parameter"]: abs(row["off by %"]) for row in parameters}
        assert max(value for name, value in away.items() if "ω" not in name) < 2.0
        bristle = content["figures"]["table2"]["tables"][1]["rows"]
        assert [row["parameter"] for row in bristle] == ["σ0", "σ1,0", "ω_σ1"]
        stiffness = bristle[0]
        assert abs(stiffness["off by %"]) < 10.0
        assert 0.0 < stiffness["95 % half width"] < 0.2 * stiffness["found here"]

    def test_compensation_and_extensions_do_what_the_paper_says(
        self, content: dict[str, Any]
    ) -> None:
        errors = {row["estimate"]: row for row in content["figures"]["fig11"]["tables"][0]["rows"]}
        assert errors["2Q-fa"]["moving in N"] < 25.0
        assert errors["w/o FC"]["moving in N"] > 200.0
        rests = {row["estimate"]: row for row in content["figures"]["fig12"]["tables"][1]["rows"]}
        assert rests["2Q-fa"]["largest drift in N/s"] < 5.0
        assert rests["no exten"]["largest drift in N/s"] > 10.0

    def test_what_does_not_agree_is_said(self, content: dict[str, Any]) -> None:
        """The single mass has no torsion bar, and the map ends where the sweep goes on."""
        assert content["outcomes"]["does not agree"] >= 1
        one = content["figures"]["fig5"]["statements"][0]
        assert one["outcome"] == "does not agree"

    def test_the_same_seed_gives_the_same_numbers(
        self, tmp_path: Path, content: dict[str, Any]
    ) -> None:
        again = figure12.make(Workbench(seed=0, quick=True), tmp_path).content()
        assert json.loads(json.dumps(again)) == content["figures"]["fig12"]


class TestStatements:
    @pytest.mark.parametrize(
        ("one", "outcome"),
        [
            (at_most("c", "m", 0.1, "", (0.1, 0.2)), Outcome.AGREES),
            (at_most("c", "m", 0.15, "", (0.1, 0.2)), Outcome.PARTLY),
            (at_most("c", "m", 0.3, "", (0.1, 0.2)), Outcome.DISAGREES),
            (at_least("c", "m", 5.0, "N", (5.0, 2.0)), Outcome.AGREES),
            (at_least("c", "m", 2.0, "N", (5.0, 2.0)), Outcome.PARTLY),
            (at_least("c", "m", 1.9, "N", (5.0, 2.0)), Outcome.DISAGREES),
            (at_most("c", "m", math.nan, "", (0.1, 0.2)), Outcome.DISAGREES),
        ],
    )
    def test_outcome_by_the_number(self, one: Statement, outcome: Outcome) -> None:
        assert one.outcome is outcome

    def test_the_sentence_holds_number_unit_and_limits(self) -> None:
        said = at_least("c", "drift", 12.345, "N/s", (10.0, 5.0)).sentence
        assert said == "drift: 12.3 N/s (agrees: at least 10 N/s; partly: at least 5 N/s)"

    def test_cells_of_a_table(self) -> None:
        table = Table("t", ("a", "b"), (("x", math.nan), ("y", 4.345e-5), ("z", 0.0)))
        assert table.cells() == [["x", "–"], ["y", "4.345e-05"], ["z", "0"]]
        assert shown(1234.56) == "1235"


class TestMeasures:
    def test_a_delay_is_found_between_samples(self) -> None:
        time_s = np.arange(4000) / 1000.0
        reference = np.sin(2 * np.pi * 3.7 * time_s) + 0.3 * np.sin(2 * np.pi * 1.1 * time_s)
        for late_s in (-0.0104, 0.0, 0.0223):
            value = 2.0 * (
                np.sin(2 * np.pi * 3.7 * (time_s - late_s))
                + 0.3 * np.sin(2 * np.pi * 1.1 * (time_s - late_s))
            )
            assert delay_s(time_s, value, reference) == pytest.approx(late_s, abs=1e-4)

    def test_drift_and_settling(self) -> None:
        time_s = np.arange(2000) / 1000.0
        assert drift_per_s(time_s + 7.0, 3.0 * time_s - 1.0) == pytest.approx(3.0)
        decay = 100.0 * np.exp(-time_s / 0.1)
        assert settling_s(time_s, decay, 10.0) == pytest.approx(0.1 * math.log(10.0), abs=2e-3)
        assert settling_s(time_s, np.zeros(2000), 1.0) == 0.0
        assert rms(np.array([3.0, -3.0])) == 3.0


def test_sliding_friction_is_the_static_level() -> None:
    """Limit case of eq. 2: long after a reversal T_f is T_fs with the sign of the speed."""
    speed = np.full(500, -30.0)
    level = np.full(500, 0.2)
    assert modelled(speed, level, MODEL.friction)[-1] == pytest.approx(-0.2)


def test_a_folder_that_cannot_be_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.write_text("x")
    assert main(["reproduce", "--quick", "--out", str(file)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_result_that_cannot_be_written_is_refused_before_anything_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("eps_hil.reproduction.reproduce.FIGURES", ())
    words = ["reproduce", "--out", str(tmp_path / "out"), "--json", str(tmp_path / "no" / "r.json")]
    assert main(words) == 2
    assert "does not exist" in capsys.readouterr().err
    assert list((tmp_path / "out").iterdir()) == []
