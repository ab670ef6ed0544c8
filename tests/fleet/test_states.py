"""Units in two states: which recordings are whose, a bad unit is a row, and what the page says."""

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyarrow.parquet
import pytest

from eps_hil.api import jobs
from eps_hil.cli.main import main
from eps_hil.errors import InputError
from eps_hil.fleet import population_page, workers
from eps_hil.fleet.batch import run_batch
from eps_hil.fleet.job import Job, Row, run
from eps_hil.fleet.tasks import Task, states_of

MODEL = Path(__file__).parents[2] / "configs" / "reference_rig.yaml"
TEXT = "time_s,motor_torque_nm\n{0}.0,0.1\n{0}.1,0.2\n"
HOLDOUT = {"baseline": {"torque_nrmse": 0.2}, "augmented": {"torque_nrmse": 0.1}}


def recording(path: Path, at_s: int = 0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(TEXT.format(at_s))
    return path


def content(*findings: dict[str, Any], undecided: tuple[str, ...] = ()) -> dict[str, Any]:
    return {
        "verdict": "explained" if findings else "no_mismatch",
        "findings": list(findings),
        "seen_in": "after",
        "undecided": list(undecided),
        "fit": {
            "holdout": HOLDOUT,
            "improvement": {"torque_residual": {"share": 0.75, "ci95": [0.7, 0.8]}},
        },
    }


HIGHER = {
    "effect": "inertia",
    "confidence": 0.95,
    "confusable_with": ["viscous_friction"],
    "parameters": {"scale": {"value": 1.2, "unit": "1", "ci95": [1.1, 1.3]}},
    "change": {
        "is": "higher", "before": [], "size_after": 1.2,
        "numbers": [{"name": "inertia_kg_m2", "before": 2e-4, "after": 2.4e-4, "unit": "kg m²"}],
    },
}  # fmt: skip


def named(tasks: list[Task], of: Path) -> list[tuple[str, list[str], list[str]]]:
    def below(paths: tuple[Path, ...]) -> list[str]:
        return [str(path.relative_to(of)) for path in paths]

    return [(task.unit, below(task.before), below(task.after)) for task in tasks]


def test_a_folders_states_and_units(tmp_path: Path) -> None:
    for name in (
        "car 7/before/2.csv", "car 7/before/1.csv", "car 7/After/deep/1.csv",
        "before/car 8.csv", "after/car 8.csv", "car 7/before/.3.csv", "car 7/model.yaml",
        "out/changes/after/1.csv",
    ):  # fmt: skip
        recording(tmp_path / name)
    tasks = states_of(tmp_path, tmp_path / "out")
    assert named(tasks, tmp_path) == [
        ("car 7", ["car 7/before/1.csv", "car 7/before/2.csv"], ["car 7/After/deep/1.csv"]),
        ("car 8", ["before/car 8.csv"], ["after/car 8.csv"]),
    ]
    assert [task.path.name for task in tasks] == ["1.csv", "car 8.csv"]
    assert not any(task.wrong for task in tasks)


def test_a_tables_states_in_the_order_of_its_rows(tmp_path: Path) -> None:
    table = tmp_path / "list.csv"
    table.write_text(
        "unit,path,state,who\ncar 7,b.csv,before,\ncar 7,a.csv,before,me\ncar 7,c.csv, After ,\n"
        ",monday/rig.csv,before,\n,friday/rig.csv,after,\n"
    )
    assert named(states_of(table), tmp_path) == [
        ("car 7", ["b.csv", "a.csv"], ["c.csv"]),
        ("rig", ["monday/rig.csv"], ["friday/rig.csv"]),
    ]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("path,unit\na.csv,x\n", "list.csv: line 1: column state is missing; say before or after"),
        ("unit,state\nx,after\n", "list.csv: line 1: column path is missing"),
        (
            "path,state\na.csv,before\nb.csv,befor\n",
            "list.csv: line 3, column state: 'befor' is no state; before or after",
        ),
        ("path,state\n", "holds no recording"),
    ],
)
def test_a_table_that_cannot_be_meant(rows: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "list.csv").write_text(rows)
    with pytest.raises(InputError) as error:
        states_of(tmp_path / "list.csv")
    assert said in str(error.value)


def test_a_folder_without_any_state(tmp_path: Path) -> None:
    recording(tmp_path / "car 7" / "1.csv")
    with pytest.raises(InputError, match="no folder called before or after; lay recordings below"):
        states_of(tmp_path)


def test_a_unit_that_cannot_be_done_says_why(tmp_path: Path) -> None:
    table = tmp_path / "list.csv"
    for name in ("lacks/before/1.csv", "stray/before/1.csv", "stray/after/1.csv", "stray/0.csv"):
        recording(tmp_path / name)
    lacks, stray = states_of(tmp_path)
    assert lacks.wrong == (
        f"{tmp_path}: unit lacks: no recording of the state after; put some below lacks/after"
    )
    assert stray.wrong.startswith(f"{tmp_path}/stray/0.csv: lies below no folder called before or")
    table.write_text(
        "unit,path,state\nboth,1.csv,before\nboth,x/../1.csv,after\n"
        "twice,2.csv,before\ntwice,3.csv,after\ntwice,3.csv,after\none,4.csv,after\n"
    )
    both, one, twice = states_of(table)
    assert both.wrong.endswith("1.csv: is both before and after; two states are compared")
    assert one.wrong == (
        f"{table}: unit one: no recording of the state before; name some in the table"
    )
    assert twice.wrong.endswith("3.csv: is given twice; name each recording once")


def test_a_unit_is_done_again_where_a_recording_of_it_is_another(tmp_path: Path) -> None:
    for state in ("before", "after"):
        recording(tmp_path / "in" / "x" / state / "1.csv")
    of = Job("changes", MODEL, tmp_path / "out")
    keys = [of.key(states_of(tmp_path / "in")[0]) for _ in range(2)]
    recording(tmp_path / "in" / "x" / "before" / "2.csv")
    keys.append(of.key(states_of(tmp_path / "in")[0]))
    (tmp_path / "in" / "x" / "before" / "1.csv").write_text(TEXT.format(10))
    keys.append(of.key(states_of(tmp_path / "in")[0]))
    assert len({*keys}) == 3
    one, other = tmp_path / "1.csv", tmp_path / "2.csv"
    assert of.key(Task(other, "x", (one,), (other,))) != of.key(Task(one, "x", (other,), (one,)))


def test_the_row_of_a_unit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[Any] = []

    def changes(before: Any, after: Any, model: Path) -> Any:
        heard.append(([one.name for one in before], [one.name for one in after], model))
        return SimpleNamespace(content=content(HIGHER), verdict="explained")

    monkeypatch.setattr(jobs, "changes", changes)
    first = [recording(tmp_path / "before" / name) for name in ("a/1.csv", "b/1.csv")]
    second = recording(tmp_path / "after" / "1.csv", at_s=1_700_000_000)
    of = Job("changes", MODEL, tmp_path / "out", reading={"ignore_unknown": True})
    row = run(of, Task(second, "rig 7/left", tuple(first), (second,)), "key")
    assert (row["state"], row["verdict"], row["start_s"]) == ("done", "explained", 1.7e9)
    assert heard == [([str(one) for one in first], [str(second)], MODEL)]
    assert row["recordings_before"] == [str(one) for one in first]
    assert row["output"] == "changes/rig_7_left-key.json"
    assert json.loads((of.out / row["output"]).read_text())["seen_in"] == "after"
    (number,) = row["changes"]
    assert (number["change"], number["parameter"]) == ("higher", "inertia_kg_m2")
    values = {one["quantity"]: one for one in row["values"]}
    assert values["inertia"]["value"] == 0.95
    assert values["inertia.inertia_kg_m2"]["value"] == pytest.approx(0.4e-4)
    assert values["inertia.inertia_kg_m2"]["low"] == pytest.approx(0.2e-4)
    assert values["torque_nrmse_as_before"]["value"] == 0.2


@pytest.fixture
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Of a batch of four units: one has changed, one has not, one may have, one is broken."""
    told = {
        "changed": content(HIGHER), "same": content(), "unsure": content(undecided=("stribeck",)),
    }  # fmt: skip

    def changes(before: Any, _after: Any, _model: Path) -> Any:
        found = told[Path(before[0].name).parts[-3]]
        return SimpleNamespace(content=found, verdict=found["verdict"])

    monkeypatch.setattr(jobs, "changes", changes)
    for unit in (*told, "broken"):
        for state in ("before", "after"):
            recording(tmp_path / "in" / unit / state / "1.csv")
    (tmp_path / "in" / "broken" / "after" / "1.csv").write_text("time_s,motor_torque_nm\n0,x\n")

    def here(of: Job, todo: workers.Todo, *_: Any) -> Iterator[Row]:
        for task, key in todo:
            yield run(of, task, key)

    monkeypatch.setattr(workers, "here", here)
    return tmp_path / "out"


def test_the_tables_and_the_page(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["batch", "changes", str(out.parent / "in"), "--model", str(MODEL), "--out", str(out)]
    assert main(words) == 0
    said = capsys.readouterr()
    assert "4 units, 0 of them known before, 1 failed" in said.out
    assert "changes.parquet" in said.out
    assert "2/4 changed: done" in said.err
    assert "1/4 broken: " in said.err
    assert "'x' is not a number" in said.err
    rows = pyarrow.parquet.read_table(out / "changes.parquet").to_pylist()
    assert [(row["unit"], row["change"], row["effect"]) for row in rows] == [
        ("changed", "higher", "inertia"), ("same", "nothing", ""),
        ("unsure", "undecided", "stribeck"),
    ]  # fmt: skip
    assert rows[0]["after_low"] == pytest.approx(2.2e-4)
    assert rows[0]["holdout_gain"] == 0.75
    results = pyarrow.parquet.read_table(out / "results.parquet").to_pylist()
    assert [row["state"] for row in results] == ["failed", "done", "done", "done"]
    assert results[1]["recordings_after"] == results[1]["recording"]
    page = (out / "population.html").read_text()
    assert "4 units in two states; 1 failed" in page
    assert "Nothing that their recordings could show, in 1 of 3 units: same." in page
    assert "<td>inertia</td><td>higher</td><td>1 of 3</td>" in page
    assert "<td>stribeck</td><td>undecided</td>" in page
    assert "0.00022 to 0.00026" in page

    assert main(words) == 0
    assert "4 units, 4 of them known before, 1 failed" in capsys.readouterr().out
    assert main([*words, "--retry-failed"]) == 0
    assert "4 units, 3 of them known before, 1 failed" in capsys.readouterr().out


def test_nothing_has_changed_in_any(out: Path, tmp_path: Path) -> None:
    of = Job("changes", MODEL, out)
    task = next(one for one in states_of(tmp_path / "in") if one.unit == "same")
    batch = run_batch(of, [task])
    page = population_page.write(batch, tmp_path / "page.html", "x").read_text()
    assert "in 1 of 1 units: same." in page
    assert "<th>change</th>" not in page


def test_not_one_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording(tmp_path / "in" / "x" / "before" / "1.csv")
    words = ["batch", "changes", str(tmp_path / "in"), "--model", str(MODEL)]
    assert main([*words, "--out", str(tmp_path / "out"), "--processes", "1"]) == 1
    assert "not one unit could be used" in capsys.readouterr().err
