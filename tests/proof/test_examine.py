"""Cases are diagnosed apart from each other and from whoever knows the answers."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from eps_hil.proof.examine import PROBLEM, Diagnoser, examine, open_cases


def _case(folder: Path, header: str) -> Path:
    folder.mkdir(parents=True)
    (folder / "model.yaml").write_text("model: {}\n")
    (folder / "train_1.csv").write_text(f"{header}\n0,0\n")
    return folder


def test_what_goes_wrong_is_noted_and_the_next_case_is_not_touched_by_it(tmp_path: Path) -> None:
    ids = [_case(tmp_path / "cases" / name, "time_s,x").name for name in ("aa", "bb")]
    done = list(examine(tmp_path / "cases", tmp_path / "results", jobs=1))
    assert sorted(one.id for one in done) == ids
    for one in done:
        assert one.problem.startswith("exit status 2: ")
        assert "model.yaml" in one.problem
        assert (tmp_path / "results" / f"{one.id}{PROBLEM}").read_text().strip() == one.problem
    assert open_cases(tmp_path / "cases", tmp_path / "results") == []


@pytest.fixture(scope="module")
def diagnoser() -> Iterator[Diagnoser]:
    with Diagnoser() as one:
        yield one


def test_a_fork_works_in_its_own_folder_and_sees_no_other(
    tmp_path: Path, diagnoser: Diagnoser
) -> None:
    for name in ("one", "two"):
        desk = tmp_path / name
        desk.mkdir()
        assert diagnoser._run(desk, ["diagnose", "--help"]) == ""
        assert "--without-effect" in (desk / "stdout.txt").read_text()
        assert {path.name for path in desk.iterdir()} == {"stdout.txt", "stderr.txt"}


def test_time_is_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, diagnoser: Diagnoser
) -> None:
    monkeypatch.setattr("eps_hil.proof.examine._TIMEOUT_S", 0.0)
    case = _case(tmp_path / "case", "time_s,x")
    (tmp_path / "results").mkdir()
    problem = diagnoser.diagnose(case, tmp_path / "results").problem
    assert problem == "no answer within 0 s of processor time"


def test_a_result_is_not_made_twice(tmp_path: Path) -> None:
    _case(tmp_path / "cases" / "aa", "time_s,x")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "aa.json").write_text(json.dumps({"verdict": "no_mismatch"}))
    assert list(examine(tmp_path / "cases", tmp_path / "results")) == []
