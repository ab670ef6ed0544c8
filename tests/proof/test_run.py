"""A proof in batches: sealed before diagnosed, and nothing done twice after a kill."""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, Self

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.proof import run as module
from eps_hil.proof.cases import Case
from eps_hil.proof.examine import WITHOUT, Examined, arguments
from eps_hil.proof.model_file import model_yaml
from eps_hil.proof.plans import Plan
from eps_hil.proof.run import LINES, Desk, Setting, judgement, read_lines, run
from eps_hil.proof.truth import Drive
from eps_hil.proof.write import write_case

SETTING = Setting(seed=1, quick=True, proof=False, cases=5)
WORTH: dict[str, dict[str, float | None]] = {
    "baseline": {"rack_force_rmse_n": 2.0, "residual_nm": float("nan")}
}


def _case(plan: Plan) -> Case:
    effects = [
        {"effect": name, "twins": [], "wanted": level, "parameters": {}, "effect_to_noise": level}
        for name, level in plan.wanted
    ]
    answer = {"kind": plan.kind, "form": "full", "decoy": plan.decoy, "tolerated": []}
    one = {"time_s": np.arange(3.0), "motor_torque_nm": np.zeros(3)}
    recordings = {name: one for name in ("train_1", "holdout")}
    more = {"effects": effects, "withheld": list(plan.withheld), "seed": plan.seed, "size": ""}
    return Case(
        recordings, {**answer, **more}, np.arange(3.0), model_yaml(Drive()), model_yaml(Drive())
    )


class _Diagnosers:
    """A stub that says of every case, as soon as it is asked, that nothing is missing."""

    seen: ClassVar[list[str]] = []
    """Ids in the order of their diagnosis."""

    def __init__(self, _jobs: int) -> None:
        pass

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def ask(self, cases: Sequence[Path], results: Path) -> list[Future[Examined]]:
        results.mkdir(exist_ok=True)
        return [self.answer(case, results) for case in cases]

    def answer(self, case: Path, results: Path) -> Future[Examined]:
        answer: Future[Examined] = Future()
        self.seen.append(case.name)
        said = {"verdict": "no_mismatch", "findings": []}
        (results / f"{case.name}.json").write_text(json.dumps(said))
        (results / f"{case.name}.html").write_text("page")
        answer.set_result(Examined(case.name, "", 1.0))
        return answer


@pytest.fixture
def examined(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Ids in the order of their diagnosis by the stub."""
    monkeypatch.setattr(_Diagnosers, "seen", [])
    monkeypatch.setattr(module, "make", _case)
    monkeypatch.setattr(module, "write_can_case", write_case)
    monkeypatch.setattr(module, "Diagnosers", _Diagnosers)
    monkeypatch.setattr(module, "BATCH", 2)
    return _Diagnosers.seen


def _number(cases: Sequence[Path]) -> int:
    return int(cases[0].parents[1].name.removeprefix("batch_"))


def _desk(said: list[str], **more: Any) -> Desk:
    return Desk(lambda *_: WORTH, workers=ThreadPoolExecutor, say=said.append, **more)


def test_only_a_large_run_times_twenty_minutes(
    tmp_path: Path, examined: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LEAST_FOR_LONG", 6)
    timed: list[int] = []

    def clock(seed: int) -> float:
        timed.append(seed)
        return 12.5

    full = Setting(seed=3, quick=False, proof=False, cases=6)
    for resume in (False, True):
        run(tmp_path / "full", full, _desk([], time_long=clock), resume=resume)
    run(tmp_path / "quick", SETTING, _desk([], time_long=clock))
    assert timed == [3]
    assert module.long_seconds(tmp_path / "full") == 12.5
    assert module.long_seconds(tmp_path / "quick") is None
    assert len(examined) == 11


def test_a_run_from_end_to_end(tmp_path: Path, examined: list[str]) -> None:
    said: list[str] = []
    lines = run(tmp_path / "proof", SETTING, _desk(said))
    assert len(lines) == len(set(examined)) == 5
    assert [line["batch"] for line in lines] == [1, 1, 2, 2, 3]
    assert lines == read_lines(tmp_path / "proof")
    assert lines[0]["worth"]["baseline"] == {"rack_force_rmse_n": 2.0, "residual_nm": None}
    assert {judgement(line).verdict for line in lines} == {"no_mismatch"}
    wrong = [line for line in lines if line["failed"]]
    assert wrong
    for line in lines:  # pages of failures are kept, recordings are not
        assert bool(line["report"]) == bool(line["failed"])
    for line in wrong:
        assert (tmp_path / "proof" / line["report"]).read_text() == "page"
    assert not list((tmp_path / "proof").glob("batch_*/cases"))


def test_the_hash_is_published_before_a_diagnosis_begins(
    tmp_path: Path, examined: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    out = tmp_path / "proof"

    class Watched(_Diagnosers):
        def ask(self, cases: Sequence[Path], results: Path) -> list[Future[Examined]]:
            (value,) = (
                line.split()[1]
                for line in (out / "seals.txt").read_text().splitlines()
                if line.startswith(f"{_number(cases)} ")
            )
            assert any(value in line for line in said)
            return super().ask(cases, results)

    monkeypatch.setattr(module, "Diagnosers", Watched)
    assert len(run(out, SETTING, _desk(said))) == len(examined)


def test_the_next_batch_is_hidden_while_one_is_diagnosed(
    tmp_path: Path, examined: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "proof"

    class Slow(_Diagnosers):
        def ask(self, cases: Sequence[Path], results: Path) -> list[Future[Examined]]:
            number, end = _number(cases), time.monotonic() + 20.0
            while number < 3 and f"\n{number + 1} " not in "\n" + (out / "seals.txt").read_text():
                assert time.monotonic() < end, "the next batch was never sealed"
                time.sleep(0.01)
            return super().ask(cases, results)

    monkeypatch.setattr(module, "Diagnosers", Slow)
    assert len(run(out, SETTING, _desk([]))) == 5
    assert len(set(examined)) == 5


def test_the_next_batch_is_diagnosed_beside_the_last_cases_of_one(
    tmp_path: Path, examined: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first batch's last case is answered only after the second batch was asked for."""
    late: list[Callable[[], object]] = []

    class Late(_Diagnosers):
        def ask(self, cases: Sequence[Path], results: Path) -> list[Future[Examined]]:
            if _number(cases) == 1:
                *soon, last = cases
                coming: Future[Examined] = Future()
                late.append(lambda: coming.set_result(self.answer(last, results).result()))
                return [*super().ask(soon, results), coming]
            while late:
                late.pop()()
            return super().ask(cases, results)

    monkeypatch.setattr(module, "Diagnosers", Late)
    lines = run(tmp_path / "proof", SETTING, _desk([]))
    assert [line["batch"] for line in lines] == [1, 1, 2, 2, 3]
    assert len(examined) == len(set(examined)) == 5
    assert all(line["seconds"] == 1.0 for line in lines)


def test_a_written_model_that_cannot_be_read_is_a_failure_and_no_end(
    tmp_path: Path, examined: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It gains nothing over the model file as it was."""

    class Writing(_Diagnosers):
        def answer(self, case: Path, results: Path) -> Future[Examined]:
            (results / f"{case.name}.yaml").write_text("model: {}\n")
            return super().answer(case, results)

    def measure(case: Path, _force: Any, models: Mapping[str, Path]) -> dict[str, Any]:
        if "augmented" in models:
            raise InputError(models["augmented"], "model", "is empty", "write one")
        return {name: {"rack_force_rmse_n": 2.0, "residual_nm": 1.0} for name in models}

    monkeypatch.setattr(module, "Diagnosers", Writing)
    lines = run(tmp_path / "proof", SETTING, Desk(measure, workers=ThreadPoolExecutor))
    assert len(lines) == 5
    for line in lines:
        assert line["failed"]
        assert line["problem"].endswith(".yaml: model: is empty; write one")
        assert line["worth"]["augmented"] == line["worth"]["baseline"]


def test_a_killed_run_goes_on_where_it_stopped(
    tmp_path: Path, examined: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "proof"

    class Killed(_Diagnosers):
        def answer(self, case: Path, results: Path) -> Future[Examined]:
            if len(examined) == 5:
                raise KeyboardInterrupt
            return super().answer(case, results)

    more = replace(SETTING, cases=7)
    monkeypatch.setattr(module, "Diagnosers", Killed)
    with pytest.raises(KeyboardInterrupt):
        run(out, more, _desk([]))
    assert len(read_lines(out)) == 2  # the whole batch that was finished
    seals = (out / "seals.txt").read_text()
    monkeypatch.setattr(module, "Diagnosers", _Diagnosers)
    with pytest.raises(InputError, match="--resume"):
        run(out, more, _desk([]))
    lines = run(out, more, _desk([]), resume=True)
    assert len(lines) == 7
    assert len(examined) == len(set(examined)) == 7  # none was diagnosed twice
    assert (out / "seals.txt").read_text().startswith(seals)


def test_other_options_are_another_run(tmp_path: Path, examined: list[str]) -> None:
    run(tmp_path / "proof", SETTING, _desk([]))
    other = Setting(seed=2, quick=True, proof=False, cases=5)
    with pytest.raises(InputError, match="other options"):
        run(tmp_path / "proof", other, _desk([]), resume=True)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("do not touch")
    with pytest.raises(InputError, match="not empty"):
        run(tmp_path / "mine", SETTING, _desk([]))
    assert len(examined) == 5


def test_some_kinds_alone_are_a_run_that_goes_on(tmp_path: Path, examined: list[str]) -> None:
    some = Setting(seed=1, quick=True, proof=False, cases=9, kinds=("pairs", "aliens"))
    assert [plan.kind for plan in some.plans()].count("pairs") == 2
    lines = run(tmp_path / "some", some, _desk([]))
    assert {line["answer"]["kind"] for line in lines} == {"pairs", "aliens"}
    assert run(tmp_path / "some", some, _desk([]), resume=True) == lines
    assert len(examined) == len(lines) == 3


def test_nothing_is_begun_by_mistake(tmp_path: Path, examined: list[str]) -> None:
    with pytest.raises(InputError, match="no proof to go on with"):
        run(tmp_path / "proof", SETTING, _desk([]), resume=True)
    assert not (tmp_path / "proof").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="--out: cannot be made"):
        run(tmp_path / "file" / "proof", SETTING, _desk([]))
    (tmp_path / "torn").mkdir()
    (tmp_path / "torn" / "run.json").write_text('{"seed":')
    with pytest.raises(InputError, match=r"run\.json: is damaged"):
        run(tmp_path / "torn", SETTING, _desk([]), resume=True)
    assert examined == []


def test_answers_that_were_changed_are_noticed(
    tmp_path: Path, examined: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "proof"

    class Forged(_Diagnosers):
        def answer(self, case: Path, results: Path) -> Future[Examined]:
            path = results.parent / "answers.json"
            path.write_text(path.read_text().replace('"full"', '"simple"'))
            return super().answer(case, results)

    monkeypatch.setattr(module, "Diagnosers", Forged)
    with pytest.raises(InputError, match="seal is broken"):
        run(out, SETTING, _desk([]))
    assert not (out / LINES).exists()


def test_what_is_to_be_left_out_reaches_the_diagnosis(tmp_path: Path) -> None:
    (tmp_path / WITHOUT).write_text("stribeck\nbreakaway_dwell\n")
    given = " ".join(arguments(["model.yaml", "train_1.csv", WITHOUT], tmp_path))
    assert given.endswith("--without-effect stribeck --without-effect breakaway_dwell")


@pytest.mark.slow
def test_workers_end_with_whoever_started_them() -> None:
    """Killed as nothing can catch it, a run leaves no process behind."""
    script = (
        "import os, time\n"
        "from eps_hil.proof.run import strangers\n"
        "if __name__ == '__main__':\n"
        "    pool = strangers(1)\n"
        "    print(pool.submit(os.getpid).result(), flush=True)\n"
        "    time.sleep(100)\n"
    )
    with TemporaryDirectory() as folder:
        file = Path(folder) / "begin.py"
        file.write_text(script)
        begun = subprocess.Popen([sys.executable, str(file)], stdout=subprocess.PIPE, text=True)
        assert begun.stdout is not None
        worker = int(begun.stdout.readline())
        begun.kill()
        begun.communicate()
    until = time.monotonic() + 60.0
    while _runs(worker) and time.monotonic() < until:
        time.sleep(0.1)
    assert not _runs(worker)


def _runs(process: int) -> bool:
    stat = Path(f"/proc/{process}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"
