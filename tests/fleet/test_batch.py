"""Batches: resumable and idempotent, one bad file is a row, processes and Dask workers may die."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest

from eps_hil.api import jobs
from eps_hil.cli.main import main
from eps_hil.errors import InputError
from eps_hil.fleet import population_page, workers
from eps_hil.fleet.batch import run_batch
from eps_hil.fleet.job import Job, Row, run
from eps_hil.fleet.population import population
from eps_hil.fleet.tasks import Task, tasks_of
from eps_hil.recordings.write import write_table
from eps_hil.report import figures

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "configs" / "reference_rig.yaml"


def recording(path: Path, seed: int = 1, seconds: float = 2.0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * 1000)) * 1e-3
    speed = 20 * np.sin(3 * t)
    columns = {
        "time_s": 1000.0 * seed + t,
        "motor_torque_nm": 0.3 * np.sin(3 * t + 0.4) + rng.normal(0, 5e-3, len(t)),
        "motor_speed_rad_s": speed + rng.normal(0, 0.1, len(t)),
        "motor_angle_rad": np.cumsum(speed) * 1e-3,
        "rack_force_n": 700 * np.sin(3 * t + 0.4) + 10 * seed,
    }
    write_table(path, columns)
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two units with two recordings each, a broken one, and a file that is none."""
    source = tmp_path / "recordings"
    for seed, name in enumerate(["a/1.csv", "a/2.parquet", "b/1.csv", "b/2.csv"], start=1):
        recording(source / name, seed)
    (source / "b" / "broken.csv").write_text("time_s,motor_torque_nm\n0.0,x\n")
    (source / "notes.txt").write_text("no recording")
    return source


def job(tmp_path: Path) -> Job:
    return Job("estimate", MODEL, tmp_path / "out")


def test_the_folders_and_the_tables_units(folder: Path) -> None:
    found = tasks_of(folder)
    assert [(task.path.name, task.unit) for task in found] == [
        ("1.csv", "a"), ("2.parquet", "a"), ("1.csv", "b"), ("2.csv", "b"), ("broken.csv", "b"),
    ]  # fmt: skip
    table = folder / "list.txt"
    table.write_text("unit,path,operator\ncar 7,a/1.csv,me\n,b/2.csv,\n,gone.csv,\n")
    assert tasks_of(table) == [
        Task(folder / "a/1.csv", "car 7"), Task(folder / "b/2.csv", "2"),
        Task(folder / "gone.csv", "gone"),
    ]  # fmt: skip


def test_linked_folders_are_followed_once_and_never_in_a_circle(
    folder: Path, tmp_path: Path
) -> None:
    """They were left out, and nothing was said."""
    recording(tmp_path / "elsewhere" / "deep" / "3.csv")
    (folder / "c").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "back").symlink_to(folder)
    (folder / "0_first").symlink_to(folder / "b")
    (folder / "a" / "up").symlink_to(tmp_path)
    (folder / "gone").symlink_to(tmp_path / "nowhere")
    plain = [("1.csv", "a"), ("2.parquet", "a"), ("1.csv", "b"), ("2.csv", "b"),
             ("broken.csv", "b")]  # fmt: skip
    found = tasks_of(folder)
    assert [(task.path.name, task.unit) for task in found] == [*plain, ("3.csv", "c")]
    out = folder / "c" / "deep"
    assert [(task.path.name, task.unit) for task in tasks_of(folder, out)] == plain


def test_what_a_batch_writes_is_no_recording(folder: Path) -> None:
    recordings = tasks_of(folder)
    recording(folder / "a" / ".4.csv")  # as a file is called while it is written
    recording(folder / ".trash" / "5.csv")
    recording(folder / "results" / "estimates" / "1.parquet")
    recording(folder / "results.parquet")
    assert tasks_of(folder, folder / "results") == [
        *recordings, Task(folder / "results.parquet", "results"),
    ]  # fmt: skip
    recording(folder / "estimates" / "1.parquet")
    (folder / "results" / "estimates" / "1.parquet").unlink()
    assert tasks_of(folder, folder) == recordings


def test_a_row_is_of_its_catalogue(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one, task = job(folder), tasks_of(folder)[0]
    before = one.key(task)
    assert one.key(task) == before
    monkeypatch.setattr("eps_hil.fleet.job._catalogue", lambda: "another")
    assert one.key(task) != before


def test_the_readers_notes_and_a_recording_without_a_date(tmp_path: Path) -> None:
    path = recording(tmp_path / "a" / "1.csv")
    text = path.read_text()
    lines = text.splitlines()
    path.write_text("\n".join([lines[0] + ",mine", *(line + ",1" for line in lines[1:])]) + "\n")
    dated = path.with_name("0.csv")
    rows = [line.split(",", 1) for line in lines[1:]]
    dated.write_text("\n".join([lines[0], *(f"{1.7e9 + float(t)!r},{x}" for t, x in rows)]) + "\n")
    of = Job("estimate", MODEL, tmp_path / "out", reading={"ignore_unknown": True})
    batch = run_batch(of, tasks_of(tmp_path / "a"), processes=1)
    assert [row["start_s"] for row in batch.rows] == [pytest.approx(1_700_001_000.0), None]
    assert [len(row["notes"]) for row in batch.rows] == [0, 1]
    results = pyarrow.parquet.read_table(batch.results).to_pylist()
    assert results[0]["notes"] == ""
    assert "mine" in results[1]["notes"]
    page = population_page.write(batch, tmp_path / "page.html", "mine").read_text()
    assert "1 with notes of the reader" in page
    assert "Recordings without a date (1) stand by path" in page
    assert "mine" in page[page.index("Notes of the reader") :]


def test_no_number_of_a_result_is_nan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = SimpleNamespace(value=math.nan, unit="Nm", ci95=None, status="identified")
    found = SimpleNamespace(
        content=lambda: {"fit": {"residual_rms_nm": math.nan}}, parameters={"x": one}, offsets={}
    )
    monkeypatch.setattr(jobs, "identify", lambda *_: SimpleNamespace(result=found))
    of = Job("identify", MODEL, tmp_path / "out")
    row = run(of, Task(recording(tmp_path / "1.csv"), "a"), "key")
    assert (row["state"], row["values"]) == ("done", [])
    told = json.loads((tmp_path / "out" / row["output"]).read_text())
    assert told == {"fit": {"residual_rms_nm": None}}


@pytest.mark.parametrize(
    ("text", "said"), [(None, "no such file"), ("a,b\n", "column path"), ("path\n", "no recording")]
)
def test_what_is_no_source(tmp_path: Path, text: str | None, said: str) -> None:
    table = tmp_path / "list.csv"
    if text is not None:
        table.write_text(text)
    with pytest.raises(InputError, match=said.replace("no such file", "(?i)no such file")):
        tasks_of(table)


@pytest.mark.slow
def test_the_verb_goes_on_where_it_was(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["batch", "estimate", str(folder), "--model", str(MODEL), "--out", str(out)]
    assert main([*words, "--processes", "2"]) == 0
    said = capsys.readouterr()
    assert "5 recordings, 0 of them known before, 1 failed, 0 with notes of the reader" in said.out
    assert "to try failed ones again, give --retry-failed" in said.out
    assert "broken.csv" in said.err
    assert "/5 " in said.err  # how far it is
    assert len(said.out.splitlines()) == 1
    results = pyarrow.parquet.read_table(out / "results.parquet").to_pylist()
    assert [row["state"] for row in results] == ["done"] * 4 + ["failed"]
    assert "line 2" in results[4]["error"]
    assert all((out / row["output"]).exists() for row in results[:4])
    values = pyarrow.parquet.read_table(out / "values.parquet").to_pylist()
    assert {(one["quantity"], one["si"]) for one in values} == {
        ("valid_share", ""), ("error_moving", "N"), ("error_overall", "N"), ("bias_moving", "N"),
    }  # fmt: skip
    assert {one["unit"] for one in values} == {"a", "b"}
    page = (out / "population.html").read_text()
    assert "error_moving" in page
    assert "broken.csv" in page
    before = {path: path.stat().st_mtime_ns for path in (out / "rows").iterdir()}

    (out / "estimates" / Path(results[0]["output"]).name).unlink()  # somebody tidied up
    recording(folder / "a" / "3.csv", 9)
    assert main(words) == 0
    assert "6 recordings, 4 of them known before, 1 failed" in capsys.readouterr().out
    changed = [path for path, at in before.items() if path.stat().st_mtime_ns != at]
    assert [path.stem for path in changed] == [results[0]["key"]]
    assert main(words) == 0
    assert "6 recordings, 6 of them known before" in capsys.readouterr().out
    assert main([*words, "--retry-failed"]) == 0
    assert "6 recordings, 5 of them known before, 1 failed" in capsys.readouterr().out


def _of_parent(parent: int) -> list[int]:
    """Processes that a process has started (Linux)."""
    found = []
    for one in Path("/proc").glob("[0-9]*/stat"):
        try:
            number, rest = one.read_text().split(" (", 1)
        except OSError:
            continue
        state, its_parent = rest.rsplit(") ", 1)[1].split()[:2]
        if int(its_parent) == parent and state != "Z":
            found.append(int(number))
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks into /proc")
def test_workers_end_with_a_batch_that_is_killed(tmp_path: Path) -> None:
    for seed in range(400):
        recording(tmp_path / "many" / f"{seed}.csv", seed, 0.2)
    rows = tmp_path / "out" / "rows"
    batch = subprocess.Popen(
        [sys.executable, "-m", "eps_hil.cli", "batch", "estimate", str(tmp_path / "many"),
         "--model", str(MODEL), "--out", str(tmp_path / "out"), "--processes", "2"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    until = time.monotonic() + 120.0
    while len(list(rows.glob("*"))) < 20 and time.monotonic() < until and batch.poll() is None:
        time.sleep(0.05)
    workers_of_it = _of_parent(batch.pid)
    batch.kill()
    batch.wait()
    assert len(workers_of_it) >= 2
    until = time.monotonic() + 20.0
    while time.monotonic() < until and any(Path(f"/proc/{k}").exists() for k in workers_of_it):
        time.sleep(0.1)
    left = [k for k in workers_of_it if Path(f"/proc/{k}").exists()]
    for one in left:
        os.kill(one, signal.SIGKILL)
    assert not left


@pytest.mark.slow
def test_ctrl_c_ends_a_batch_in_one_line(tmp_path: Path) -> None:
    """A terminal sends it to all processes: each told it in a traceback, and one might hang."""
    for k in range(200):
        (tmp_path / f"{k}.csv").write_text("time_s,motor_torque_nm\n0.0,x\n")
    batch = subprocess.Popen(
        [sys.executable, "-m", "eps_hil.cli", "batch", "identify", str(tmp_path),
         "--model", str(MODEL), "--out", str(tmp_path / "out"), "--processes", "2"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    assert batch.stderr is not None
    for _ in range(50):
        assert "'x' is not a number" in batch.stderr.readline()
    os.killpg(batch.pid, signal.SIGINT)
    _, said = batch.communicate(timeout=60.0)
    assert batch.returncode == 130
    *rows, last = said.splitlines()
    assert last == "eps-hil: interrupted"
    assert all("'x' is not a number" in row for row in rows), said


def test_nothing_that_could_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.csv").write_text("time_s\n0\n")
    words = ["batch", "identify", str(tmp_path / "in"), "--model", str(MODEL)]
    assert main([*words, "--out", str(tmp_path / "out")]) == 1
    assert "not one recording could be used" in capsys.readouterr().err


def test_a_database_that_is_not_there_is_wrong_input(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["batch", "identify", str(folder), "--model", str(MODEL), "--dbc", "no.dbc"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    assert "no.dbc: no such file" in capsys.readouterr().err


def test_what_failed_is_tried_again_when_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks = [Task(tmp_path / f"{k}.csv", f"{k}") for k in range(3)]
    of, broken = job(tmp_path), {"1"}
    asked: list[str] = []

    def here(of: Job, todo: workers.Todo, *_: Any) -> Iterator[Row]:
        for task, key in todo:
            asked.append(task.unit)
            state = "failed" if task.unit in broken else "done"
            yield {**deadly(of, task, key), "state": state}

    monkeypatch.setattr(workers, "here", here)
    assert [row["state"] for row in run_batch(of, tasks).rows] == ["done", "failed", "done"]
    broken.clear()
    assert len(run_batch(of, tasks).failed) == 1
    batch = run_batch(of, tasks, retry=True)
    assert (batch.before, len(batch.failed), asked) == (2, 0, ["0", "1", "2", "1"])


def test_a_number_that_does_not_exist_is_none_of_a_batch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = {"status": "identified", "unit": "", "ci95": (0.0, np.inf)}
    numbers = {"a": SimpleNamespace(value=np.nan, **one), "b": SimpleNamespace(value=1.0, **one)}
    numbers["c"] = SimpleNamespace(value=2.0, **{**one, "ci95": (None, 3.0)})
    named = SimpleNamespace(content=lambda: {"x": [np.nan, 1.0]}, parameters=numbers, offsets={})
    monkeypatch.setattr(jobs, "identify", lambda *_: SimpleNamespace(result=named))
    of = Job("identify", MODEL, tmp_path / "out")
    row = run(of, Task(recording(tmp_path / "drive.csv"), "a"), "key")
    assert row["values"] == [
        {"quantity": "b", "value": 1.0, "low": 0.0, "high": None, "si": ""},
        {"quantity": "c", "value": 2.0, "low": None, "high": 3.0, "si": ""},
    ]
    assert json.loads((of.out / row["output"]).read_text()) == {"x": [None, 1.0]}


def deadly(of: Job, task: Task, key: str) -> Row:
    """A job that some recordings take their process down with."""
    if task.unit == "deadly":
        os.kill(os.getpid(), signal.SIGKILL)
    return {"key": key, "recording": str(task.path), "unit": task.unit, "state": "done",
            "error": "", "start_s": 0.0, "output": "", "values": [], "seconds": 0.0}  # fmt: skip


def _known_to_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The job above in the place of the real one; processes find it however pytest was started."""
    monkeypatch.syspath_prepend(str(ROOT))
    monkeypatch.setattr(workers, "run", deadly)


@pytest.mark.slow
def test_a_recording_that_kills_its_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _known_to_workers(monkeypatch)
    units = ["one", "two", "deadly", "three", "four"]
    tasks = [Task(tmp_path / f"{k}.csv", unit) for k, unit in enumerate(units)]
    batch = run_batch(job(tmp_path), tasks, processes=2)
    assert [row["state"] for row in batch.rows] == ["done", "done", "failed", "done", "done"]
    assert "its process died" in batch.failed[0]["error"]


def test_no_recording_is_lost_where_the_pool_breaks_before_it_is_given_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refused: list[Task] = []

    class Breaks(ProcessPoolExecutor):
        def submit(self, function: Any, /, *words: Any, **more: Any) -> Any:
            if words[1].unit == "three" and not refused:
                refused.append(words[1])
                raise BrokenProcessPool
            return super().submit(function, *words, **more)

    monkeypatch.setattr(workers, "ProcessPoolExecutor", Breaks)
    _known_to_workers(monkeypatch)
    tasks = [Task(tmp_path / f"{k}.csv", unit) for k, unit in enumerate(["one", "two", "three"])]
    batch = run_batch(job(tmp_path), tasks, processes=2)
    assert refused
    assert [row["state"] for row in batch.rows] == ["done"] * 3


def test_outliers_of_a_population() -> None:
    def row(k: int, value: float, half: float | None) -> Row:
        ends = {"low": None, "high": None}
        if half is not None:
            ends = {"low": value - half, "high": value + half}  # type: ignore[dict-item]
        one: dict[str, Any] = {"quantity": "inertia", "value": value, "si": "kg m^2", **ends}
        return {"recording": f"{k}.csv", "unit": f"u{k // 2}", "start_s": float(k), "values": [one]}

    usual = [row(k, 1.0 + 0.01 * (k % 5), 0.001) for k in range(20)]
    (found,) = population([*usual, row(20, 1.5, 0.01), row(21, 1.6, 0.7), row(22, 1.7, None)])
    assert [p.recording for p in found.points if p.outlier] == ["20.csv", "22.csv"]
    assert found.middle == pytest.approx(1.02)
    assert found.between is not None
    (few,) = population([*usual[:3], row(20, 99.0, 0.01)])
    assert not any(p.outlier for p in few.points)


def test_the_figure_has_a_point_and_a_bar_for_each_value() -> None:
    rows = [
        {"recording": f"{k}.csv", "unit": f"u{k}", "start_s": None, "values": [
            {"quantity": "a", "value": v, "low": v - 0.1, "high": v + 0.1, "si": "Nm"}]}
        for k, v in enumerate([1.0, 1.02, 0.98, 1.01, 9.0])
    ]  # fmt: skip
    (one,) = population(rows)
    assert [p.outlier for p in one.points] == [False] * 4 + [True]
    drawn = population_page._figure(one)
    for colour in figures.COLOURS[:2]:
        assert colour.lower() in drawn.lower()
    assert all(f"LineCollection_{k}" in drawn for k in (1, 2))


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A Dask scheduler with two worker processes, as a cluster has them."""
    pytest.importorskip("distributed", reason="needs the 'fleet' extra")
    address_file = tmp_path / "scheduler.json"
    words = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0"]
    words += ["--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(address_file)]
    started = [subprocess.Popen(words, cwd=tmp_path, stderr=subprocess.DEVNULL)]
    try:
        until = time.monotonic() + 60.0
        while not address_file.exists() and time.monotonic() < until:
            time.sleep(0.1)
        for _ in range(2):
            words = [sys.executable, "-m", "distributed.cli.dask_worker", "--no-dashboard"]
            words += ["--scheduler-file", str(address_file), "--nthreads", "1", "--no-nanny"]
            words += ["--local-directory", str(tmp_path)]
            started.append(subprocess.Popen(words, cwd=tmp_path, stderr=subprocess.DEVNULL))
        yield json.loads(address_file.read_text())["address"], started[1:]
    finally:
        for process in started:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_dask_worker_that_is_killed_in_mid_run(
    scheduler: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path
) -> None:
    address, processes = scheduler
    source = tmp_path / "recordings"
    for seed in range(1, 13):
        recording(source / f"{seed:02d}.parquet", seed, seconds=20.0)
    (source / "broken.csv").write_text("time_s,motor_torque_nm\n0.0,x\n")
    tasks = tasks_of(source)
    killed: list[int] = []

    def kill_one(row: Row, done: int, _of: int) -> None:
        if done == 3:
            victim = next(one for one in processes if one.pid == row["process"])
            victim.kill()
            killed.append(victim.pid)

    batch = run_batch(job(tmp_path), tasks, dask=address, on_row=kill_one)
    assert killed
    assert [row["state"] for row in batch.rows] == ["done"] * 12 + ["failed"]
    later = {row["process"] for row in batch.rows} - set(killed)
    assert len(later) == 1  # the other one did the rest
    here = run_batch(Job("estimate", MODEL, tmp_path / "here"), tasks, processes=1)
    for there, mine in zip(batch.rows, here.rows, strict=True):
        assert there["values"] == mine["values"]
    again = run_batch(job(tmp_path), tasks, dask=address)
    assert again.before == 13


@pytest.mark.slow
def test_nobody_answers(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="needs the 'fleet' extra")
    task = Task(recording(tmp_path / "a.csv"), "a")
    with pytest.raises(InputError, match="no scheduler answers"):
        run_batch(job(tmp_path), [task], dask="tcp://127.0.0.1:1")


def test_recordings_of_one_name_have_outputs_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Among 10⁵ of one name, two keys begin alike."""
    named = SimpleNamespace(content=dict, parameters={}, offsets={})
    monkeypatch.setattr(jobs, "identify", lambda *_: SimpleNamespace(result=named))
    task = Task(recording(tmp_path / "a" / "drive.csv"), "a")
    one = Job("identify", MODEL, tmp_path / "out")
    outputs = {run(one, task, key)["output"] for key in ("0123456789abcdef", "01234567fedcba98")}
    assert len(outputs) == 2
    assert all((one.out / output).is_file() for output in outputs)
